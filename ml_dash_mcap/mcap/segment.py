"""One segment of a recorder: named as in progress while it is written, renamed when it is whole."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..file_names import ABOUT_RECORD, ACTIVE_SUFFIX, WIDER_SCHEMA_OPCODE
from .chunk_writer import PackedChunk
from .file_output import FileOutput, sync_folder
from .file_writer import FileWriter, WrittenContents
from .records import BLOCK_END, BlockEnd, MetadataEntry


class Segment(FileWriter[FileOutput]):
    """A file in progress. Used by one thread at a time.

    A call that fails leaves the file as it was before: bytes of the failed write are cut off.
    """

    def __init__(
        self,
        active_path: Path,
        output: FileOutput,
        contents: WrittenContents | None = None,
        torn_schemas: Mapping[int, int] | None = None,
    ) -> None:
        """Go on with a file; `create` makes a new one.

        Args:
            active_path: The file, with its `ACTIVE_SUFFIX`.
            output: The same, opened.
            contents: Its contents; None for an empty file.
            torn_schemas: The places of Schema records for which `contents` has other text, by id.
        """
        super().__init__(output, contents)
        self.active_path = active_path
        self.path = active_path.with_name(active_path.name.removesuffix(ACTIVE_SUFFIX))
        self._schema_at: dict[int, int] = dict(torn_schemas or {})
        self._stale_schemas: set[int] = set(self._schema_at)

    @classmethod
    def create(cls, path: Path, library: str, about: Mapping[str, str]) -> Segment:
        """Create a file.

        Args:
            path: The finished file's name; until then it has `ACTIVE_SUFFIX`.
            library: What the MCAP header names as the writer.
            about: The `ml_dash` metadata record.

        Raises:
            FileExistsError: The name is taken.
        """
        active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        if path.exists():
            raise FileExistsError(path)
        segment = cls(active_path, FileOutput(active_path, os.O_RDWR | os.O_CREAT | os.O_EXCL, mode=0o644))
        try:
            # Again, because another recorder may have finished a file of that name just before this one was created.
            if path.exists():
                raise FileExistsError(path)
            segment.begin(library)
            segment.add_metadata(ABOUT_RECORD, about)
        except BaseException:
            segment.discard()
            raise
        return segment

    @classmethod
    def reopen(
        cls, active_path: Path, size: int, contents: WrittenContents, torn_schemas: Mapping[int, int]
    ) -> Segment:
        """Take over a file that its recorder left unfinished.

        Args:
            active_path: The file, with its `ACTIVE_SUFFIX`.
            size: How much of it is sound, in bytes; the rest is cut off.
            contents: The contents of the sound part.
            torn_schemas: The places of Schema records for which `contents` has other text, by id.
        """
        return cls(active_path, FileOutput(active_path, os.O_RDWR, size), contents, torn_schemas)

    def add_message_indexes(self, indexes: Mapping[int, bytes]) -> None:
        """Write the MessageIndex records of the last chunk, by channel id, where a crash cut them off."""
        start = position = self.size
        offsets: dict[int, int] = {}
        for channel_id, index in indexes.items():
            offsets[channel_id] = position
            position += len(index)
        self.output.write(*indexes.values())
        last = self.contents.chunks[-1]
        self.contents.chunks[-1] = replace(
            last, message_index_offsets=offsets, message_index_length=position - start, indexed=True
        )

    def add_topic(self, number: int, schema: bytes, channel: bytes) -> None:
        """Write a topic's Schema and Channel records, in one call."""
        self._schema_at[number] = self.size
        self.output.write(schema, channel)
        self.contents.schemas[number] = schema
        self.contents.channels[number] = channel
        self.contents.counts.setdefault(number, 0)

    def announce_schema(self, number: int, schema: bytes) -> None:
        """Write a copy of a wider Schema record, before that is put into its place, where a crash may tear it."""
        if schema != self.contents.schemas[number]:
            self.output.write(bytes([WIDER_SCHEMA_OPCODE]) + schema[1:])

    def rewrite_schema(self, number: int, schema: bytes) -> None:
        """Put a Schema record in the place of one of the same length."""
        if len(schema) != len(self.contents.schemas[number]):
            raise AssertionError("a schema is rewritten at its length")
        if schema != self.contents.schemas[number]:
            self.contents.schemas[number] = schema
            self._stale_schemas.add(number)
        self._write_stale_schemas()

    def schema_space(self, number: int) -> int:
        """Return the length of a topic's Schema record, 0 where it has none yet."""
        return len(self.contents.schemas.get(number, b""))

    def add_block(self, chunks: Sequence[PackedChunk], number: int, name: str = "", metadata: bytes = b"") -> None:
        """Write a block's chunks with their message indexes, and the record of the block's end, in one call.

        Args:
            chunks: Of the block.
            number: Of the block.
            name: Of its metadata record.
            metadata: That record, which goes before the chunks; empty if the block has none.
        """
        at = self.size
        pieces = [piece for chunk in chunks for piece in (chunk.head, chunk.data, *chunk.indexes.values())]
        # The end of the block comes last: a recovery takes a block without it for torn.
        self.output.write(metadata, *pieces, BLOCK_END.pack(BlockEnd(number)))
        if metadata:
            self.contents.metadata.append(MetadataEntry(name, at, len(metadata)))
            at += len(metadata)
        for chunk in chunks:
            at = self.contents.add_chunk(chunk, at)

    def finish(self, sync: bool = True) -> Path:
        """Write the end of the file and give it its name; returns that. May be tried again.

        Args:
            sync: Whether to wait until the whole would survive a power cut.
        """
        data_end = self.size
        # What a failed write left behind the end would lie in the middle of the file now.
        self.output.trim()
        self._write_stale_schemas()
        try:
            self.write_end()
            if sync:
                # Before the rename, so that a file with its final name is whole after a power cut, too.
                self.output.sync()
            os.rename(self.active_path, self.path)
        except BaseException:
            self.output.cut(data_end)
            raise
        self.output.close()
        if sync:
            sync_folder(self.path.parent)
        return self.path

    def discard(self) -> None:
        """Close and delete the file."""
        self.output.close()
        self.active_path.unlink(missing_ok=True)

    def _write_stale_schemas(self) -> None:
        """Put the schemas that have changed into their places, again where that failed before."""
        for number in list(self._stale_schemas):
            self.output.overwrite(self._schema_at[number], self.contents.schemas[number])
            # Only now, so that a schema whose writing failed is written again.
            self._stale_schemas.discard(number)
