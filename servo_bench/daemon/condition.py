"""How it stands with the rig: its state, who holds the queue and why, what went wrong.

A fault holds the queue before it is told. The first cause of holding stays until somebody arms it,
whatever comes of it: neither another stop nor the run's end takes the name away.
"""

from datetime import UTC, datetime
from pathlib import Path

from servo_bench.daemon.log import Log
from servo_bench.daemon.machine import PLAYING, Event, State, after
from servo_bench.daemon.problems import ApiError

RESTARTED = "the daemon was started: look at the rig, then arm the queue"


class Condition:
    """Belongs to the daemon's event loop; `version` counts what a viewer should be told at once."""

    def __init__(self, log: Log, recordings: Path) -> None:
        self.version = 0
        self.state = State.IDLE
        self.held: str | None = RESTARTED
        self.fault: dict[str, str] | None = None
        self.confirmed = True
        """Whether the end of the last run is known to have left the rig standing."""
        self.last: dict[str, str] | None = None
        self._log = log
        self._recordings = recordings

    @property
    def playing(self) -> bool:
        """Whether the rig may be powered."""
        return self.state in PLAYING

    @property
    def standing(self) -> bool:
        """Whether the rig is known to stand."""
        return not self.playing and (self.confirmed or self.state is not State.FAULTED)

    def change(self) -> None:
        """Something that a viewer sees has changed."""
        self.version += 1

    def fire(self, event: Event) -> None:
        """Go on to the state that follows."""
        state = after(self.state, event)
        if state is not self.state:
            before, self.state = self.state, state
            self.change()
            self._log.info("state", before=before, after=state, event_text=event.value)

    def hold(self, cause: str) -> None:
        """Hold the queue."""
        if self.held in (None, RESTARTED):
            self.held = cause
        self.change()

    def fail(self, sentence: str, *, confirmed: bool) -> None:
        """A run ended with an error: hold the queue, and tell it.

        `confirmed`: it is known all the same that the rig stands.
        """
        at_utc = datetime.now(UTC).isoformat(timespec="seconds")
        sentence = sentence.replace(f"{self._recordings}/", "")
        self.fault = {"sentence": sentence, "at_utc": at_utc}
        self.confirmed = confirmed
        self.hold("a fault")
        if self.state is State.IDLE:
            self.fire(Event.STARTED)  # it is told of a run that nobody saw begin
        self.fire(Event.FAILED)
        self._log.error("fault", sentence=sentence)

    def arm(self, by: str) -> None:
        """Clear a fault and let the queue go on; ApiError while the rig is being stopped."""
        if self.state is State.STOPPING:
            raise ApiError(
                409, "stopping", "the rig is being stopped: arm the queue when it stands."
            )
        self.held, self.fault, self.confirmed = None, None, True
        self.fire(Event.ARMED)
        self._log.warning("armed", by=by)
        self.change()

    def tell(self, run_id: str, sentence: str) -> None:
        """What became of a run that is over."""
        self.last = {"id": run_id, "sentence": sentence}

    def tell_more(self, run_id: str, more: str) -> None:
        """More of it, where no other run has ended since."""
        if self.last is not None and self.last["id"] == run_id:
            self.tell(run_id, f"{self.last['sentence']} {more}")
