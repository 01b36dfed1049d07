"""The API's reference as one plain page, made from its OpenAPI description: no script, no CDN."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

METHODS = ("get", "post", "patch", "put", "delete")


def reference(openapi: Mapping[str, Any]) -> str:
    """The page for `/docs`."""
    info = openapi["info"]
    paths = [part for path, item in openapi["paths"].items() for part in _path(path, item)]
    schemas = [
        f'<h3 id="{escape(name)}">{escape(name)}</h3>{_schema(schema)}'
        for name, schema in openapi.get("components", {}).get("schemas", {}).items()
    ]
    return "\n".join(
        [
            '<!doctype html><html lang="en"><meta charset="utf-8">',
            f"<title>{escape(info['title'])} API</title>",
            f"<h1>{escape(info['title'])} API {escape(info['version'])}</h1>",
            f"<p>{escape(info.get('description', ''))}</p>",
            '<p>For programs: <a href="/openapi.json">openapi.json</a>. '
            "Live samples: WebSocket /api/live.</p>",
            "<h2>Requests</h2>",
            *paths,
            "<h2>Bodies</h2>",
            *schemas,
            "</html>",
        ]
    )


def _path(path: str, item: Mapping[str, Any]) -> Iterator[str]:
    for method in METHODS:
        if method in item:
            operation = item[method]
            yield f"<h3><code>{method.upper()} {escape(path)}</code></h3>"
            yield f"<p>{escape(operation.get('description', ''))}</p>"
            yield _list(
                f"<code>{escape(given['name'])}</code> ({escape(given['in'])}): "
                f"{_type(given['schema'])}"
                for given in operation.get("parameters", ())
            )
            body = operation.get("requestBody", {}).get("content", {})
            yield _list(f"body: {_type(content['schema'])}" for content in body.values())
            yield _list(
                f"{escape(status)}: {escape(answer.get('description', ''))} {_content(answer)}"
                for status, answer in operation.get("responses", {}).items()
            )


def _content(answer: Mapping[str, Any]) -> str:
    return " or ".join(
        _type(c["schema"]) for c in answer.get("content", {}).values() if c.get("schema")
    )


def _schema(schema: Mapping[str, Any]) -> str:
    needed = set(schema.get("required", ()))
    text = f"<p>{escape(schema.get('description', ''))}</p>"
    if "enum" in schema:
        return f"{text}<p>{escape(', '.join(str(value) for value in schema['enum']))}</p>"
    return text + _list(
        f"<code>{escape(name)}</code>: {_type(value)}{', needed' if name in needed else ''}"
        f"{'. ' + escape(value['description']) if 'description' in value else ''}"
        for name, value in schema.get("properties", {}).items()
    )


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        name = escape(schema["$ref"].rsplit("/", 1)[1])
        return f'<a href="#{name}">{name}</a>'
    for word in ("anyOf", "oneOf", "allOf"):
        if word in schema:
            return " or ".join(_type(one) for one in schema[word])
    if "properties" in schema:
        return f"object of {escape(', '.join(schema['properties']))}"
    if "const" in schema:
        return escape(repr(schema["const"]))
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    limits = [
        f"{words} {schema[key]}"
        for key, words in (
            ("minimum", "at least"),
            ("exclusiveMinimum", "above"),
            ("maximum", "at most"),
            ("maxLength", "characters at most"),
        )
        if key in schema
    ]
    return escape(", ".join([str(schema.get("type", "anything")), *limits]))


def _list(items: Iterator[str]) -> str:
    found = "".join(f"<li>{item}</li>" for item in items)
    return f"<ul>{found}</ul>" if found else ""
