"""A plate: one figure, its caption in the paper's numbering, and the numbers that go with it."""

from dataclasses import dataclass

from markupsafe import Markup

Facts = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Plate:
    """A drawn figure. `number` is its place in the paper or what it is; `facts` stand beside."""

    svg: Markup
    number: str
    caption: str
    facts: Facts = ()
