"""Makes the texts of metadata records from what users tell about a recording and its topics."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from ..errors import FieldError
from ..mcap.records import METADATA, Metadata
from ..rows.json_text import dumps, plain, plain_list
from .journal import Journal


def write_metadata(journal: Journal, name: str, values: Mapping[str, str]) -> None:
    """Put a metadata record of a name of its own into the journal; it is as safe as a row when this returns.

    Raises:
        FieldError: A name or a text is not valid Unicode, or the record is larger than a chunk.
        StateError: The recorder is closed.
    """
    journal.add_metadata(METADATA.pack(Metadata(text_of("metadata", name), texts_of(values))))
    if journal.eager is not None:
        journal.eager()


def texts_of(values: Mapping[str, str]) -> dict[str, str]:
    """Return metadata as text to text."""
    return {text_of("metadata", name): text_of(f"metadata {name!r}:", value) for name, value in values.items()}


def text_of(name: str, value: Any) -> str:
    """Return a value as text that UTF-8 can encode; `name` is for the error message."""
    text = value if isinstance(value, str) else str(value)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise FieldError(f"{name} {text!r} is not valid Unicode: {error}") from error
    return text


def parameter_text(name: str, value: Any) -> str:
    """Return a parameter as JSON, with Python's `NaN` and `Infinity` where it has them."""
    if not isinstance(name, str):
        raise FieldError(f"the name of a parameter is text, not {name!r}")
    text_of("the parameter's name", name)
    try:
        text = dumps(value, plain)
        # orjson writes NaN and infinity as null, as it does None. So only a text with null has to be written again.
        return text.decode() if b"null" not in text else json.dumps(value, default=plain_list)
    except Exception as error:  # methods of foreign objects may raise anything
        raise FieldError(f"parameter {name!r}: a {type(value).__qualname__} cannot be stored: {error}") from error


def topic_texts(
    description: str | None, tags: Iterable[str] | None, metadata: Mapping[str, Any] | None
) -> dict[str, str]:
    """Return the channel metadata of a topic, without entries that are None."""
    texts: dict[str, str] = {}
    if description is not None:
        texts["description"] = text_of("description", description)
    if tags is not None:
        words = [tags] if isinstance(tags, str) else list(tags) if isinstance(tags, Iterable) else [tags]
        if not all(isinstance(word, str) for word in words):
            raise FieldError(f"tags={tags!r}: pass a list of words")
        texts["tags"] = json.dumps([text_of("tag", word) for word in words])
    if metadata is not None:
        if not isinstance(metadata, Mapping):
            raise FieldError(f"metadata={metadata!r}: pass a dict")
        texts["metadata"] = parameter_text("metadata", dict(metadata))
    return texts
