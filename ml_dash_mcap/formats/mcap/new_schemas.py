"""The schemas of rows that are encoded anew, which grow while the rows are encoded."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ...capture.channels import ChannelInfo
from ...capture.fallbacks import Fallbacks
from ...capture.row_forms import RowForms
from ...mcap.records import SCHEMA, Schema
from ...mcap.row_arrays import Rows
from .channel_plan import NewChannel

_SPARE_BYTES = 4096
"""A schema has at least so much room to grow, and at least as much as it is long."""


class NewSchemas:
    """The schemas of the channels of one new file. What they learned stays when the file is begun again."""

    def __init__(self, channels: Iterable[NewChannel], folder: Path) -> None:
        """Begin with no rows.

        Args:
            channels: Of the file.
            folder: Where it is written, for the log.
        """
        infos = [ChannelInfo(each.number, each.source.topic, "", codec=each.codec) for each in channels if each.codec]
        self._infos = {info.number: info for info in infos}
        self._shaped = {info.number: info for info in infos if info.codec is not None and info.codec.follows_shapes}
        self._forms = RowForms(self._shaped, Fallbacks(folder))

    def learn(self, rows: Rows) -> None:
        """Widen the schemas by some rows, where these tell the schema."""
        if self._shaped:
            self._forms.of_block(rows)

    def record(self, each: NewChannel, space: int = 0) -> bytes:
        """Return a channel's Schema record.

        Args:
            each: The channel.
            space: How long the record is to be; 0 for one with room to grow, where it grows. It is longer if it does
                not fit.
        """
        if each.codec is None:
            schema = each.schema
            return (
                b"" if schema is None else SCHEMA.pack(Schema(each.number, schema.name, schema.encoding, schema.data))
            )
        shape = self._forms.shapes_of([each.number]).get(each.number) if each.is_learned else None
        schema_text = each.codec.schema(shape, each.source.topic)
        return self._infos[each.number].padded_schema_record(schema_text, space, _SPARE_BYTES)
