"""How a file closes: the groups of its summary, their offsets, the footer, the CRCs over sections."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

from tests.support.records import PREFIX_BYTES, Attachment, Footer, Record
from tests.support.sections import Sections

FOOTER_BYTES_IN_CRC = PREFIX_BYTES + 16
"""The summary CRC covers the footer up to the field that holds it."""


def problems(sections: Sections) -> Iterator[str]:
    """Every violation in the grouping, the offsets and the CRCs of a file's end."""
    groups, faults = _groups(sections.summary)
    yield from faults
    yield from _offset_problems(sections, groups)
    if sections.footer is not None:
        yield from _footer_problems(sections, sections.footer)
        yield from _summary_crc_problems(sections.data, sections.footer)
    yield from _other_crc_problems(sections)


def _groups(summary: list[Record]) -> tuple[dict[int, tuple[int, int]], list[str]]:
    """Start and end (not included) in bytes of each opcode's group, and a sentence for each record outside its group."""
    groups: dict[int, tuple[int, int]] = {}
    faults = []
    for record in summary:
        start, end = groups.get(record.opcode, (record.offset, record.offset))
        if end != record.offset:
            faults.append(f"{record.where} stands apart from its group, which ends at byte {end}.")
        groups[record.opcode] = (start, record.end)
    return groups, faults


def _offset_problems(sections: Sections, groups: dict[int, tuple[int, int]]) -> Iterator[str]:
    named: set[int] = set()
    for record in sections.offsets:
        opcode = record.group_opcode
        if opcode in named:
            yield f"{record.where} is a second offset of the group {opcode:#04x}."
        elif opcode not in groups or record.group_length == 0:
            yield f"{record.where} is for the group {opcode:#04x}, which is empty."
        elif (record.group_start, record.group_start + record.group_length) != groups[opcode]:
            start, end = groups[opcode]
            yield (
                f"{record.where} gives bytes {record.group_start} to {record.group_start + record.group_length} for the group "
                f"{opcode:#04x}, which is at bytes {start} to {end}."
            )
        named.add(opcode)
    for opcode in sorted(groups.keys() - named):
        yield f"The group {opcode:#04x} at byte {groups[opcode][0]} has no summary offset."


def _footer_problems(sections: Sections, footer: Footer) -> Iterator[str]:
    if sections.data_end is not None and footer.summary_start != sections.data_end.end:
        yield (
            f"{footer.where} has summary_start {footer.summary_start}, but the DataEnd ends at byte {sections.data_end.end}; "
            "the summary starts directly after it."
        )
    first = sections.offsets[0].offset if sections.offsets else 0
    if footer.summary_offset_start != first:
        yield f"{footer.where} has summary_offset_start {footer.summary_offset_start}, but the first SummaryOffset is at byte {first}."


def _summary_crc_problems(data: bytes, footer: Footer) -> Iterator[str]:
    actual = zlib.crc32(data[footer.summary_start : footer.offset + FOOTER_BYTES_IN_CRC])
    if footer.summary_crc == 0 and actual != 0:
        yield f"{footer.where} has no summary CRC."
    elif footer.summary_crc != actual:
        yield f"{footer.where} has the summary CRC {footer.summary_crc:#010x}, but the summary has {actual:#010x}."


def _other_crc_problems(sections: Sections) -> Iterator[str]:
    """CRCs that may be left out (0), but may not be wrong."""
    end = sections.data_end
    if end is not None:
        actual = zlib.crc32(sections.data[: end.offset])
        if end.data_section_crc not in (0, actual):
            yield f"{end.where} has the CRC {end.data_section_crc:#010x}, but the data section has {actual:#010x}."
    for record in sections.body:
        if isinstance(record, Attachment) and record.crc not in (0, zlib.crc32(record.content[:-4])):
            yield f"{record.where} ({record.name!r}) has the CRC {record.crc:#010x}, which its fields do not have."
