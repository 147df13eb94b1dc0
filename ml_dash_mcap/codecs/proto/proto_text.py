"""Writes a file descriptor as the text of a .proto file, with its comments.

Options that other people's extensions define are left out: their names do not stand in the descriptor.

Sources: https://protobuf.dev/reference/protobuf/proto3-spec/, https://protobuf.dev/reference/protobuf/proto2-spec/,
https://github.com/protocolbuffers/protobuf/blob/main/src/google/protobuf/descriptor.proto (SourceCodeInfo: paths)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import orjson
from google.protobuf import descriptor_pb2

from . import option_text
from .type_names import TypeNames

Path = tuple[int, ...]
"""Where something stands in a descriptor: the numbers of fields and indices that lead to it, as in SourceCodeInfo."""

FILE: Path = ()
MESSAGES, FIELDS, INNER_MESSAGES = 4, 2, 3
_FILE_ENUMS, _FILE_SERVICES, _FILE_EXTENSIONS, _FILE_SYNTAX = 5, 6, 7, 12
_INNER_ENUMS, _INNER_EXTENSIONS, _ONEOFS = 4, 6, 8
_VALUES = _METHODS = 2

_LARGEST_NUMBER = 2**29
"""Ranges of field numbers that end here go to `max`."""

_Field = descriptor_pb2.FieldDescriptorProto


def comments_of(file: Any) -> dict[Path, str]:
    """Return the comments that a file descriptor has, if its compiler kept them."""
    return {
        tuple(location.path): f"{location.leading_comments}{location.trailing_comments}"
        for location in file.source_code_info.location
        if location.leading_comments or location.trailing_comments
    }


def write(file: Any, files: Iterable[Any], comments: Mapping[Path, str]) -> str:
    """Return the text of a .proto file, which a compiler makes the same descriptor of.

    Args:
        file: A `google.protobuf.FileDescriptorProto`.
        files: All files of its set, this one included, whose names tell how short a type can be written.
        comments: By path; that of the path () begins the file.
    """
    lines = _FileText(file, TypeNames(files), comments).lines()
    return "\n".join(lines) + "\n"


class _FileText:
    """The lines of one file."""

    def __init__(self, file: Any, names: TypeNames, comments: Mapping[Path, str]) -> None:
        self._file = file
        self._names = names
        self._comments = comments
        self._syntax = file.syntax or "proto2"

    def lines(self) -> list[str]:
        file = self._file
        lines = [*self._comment(FILE), *self._comment((_FILE_SYNTAX,)), self._syntax_line()]
        if file.package:
            lines += ["", f"package {file.package};"]
        imports = list(self._imports())
        if imports:
            lines += ["", *imports]
        options = [f"option {entry};" for entry in option_text.entries(file.options)]
        if options:
            lines += ["", *options]
        package = file.package
        for index, message in enumerate(file.message_type):
            lines += ["", *self._message(message, (MESSAGES, index), package)]
        for index, enum in enumerate(file.enum_type):
            lines += ["", *self._enum(enum, (_FILE_ENUMS, index))]
        for lines_of_extendee in self._extensions(file.extension, (_FILE_EXTENSIONS,), package):
            lines += ["", *lines_of_extendee]
        for index, service in enumerate(file.service):
            lines += ["", *self._service(service, (_FILE_SERVICES, index), package)]
        return lines

    def _syntax_line(self) -> str:
        if self._syntax == "editions":
            edition = descriptor_pb2.Edition.Name(self._file.edition).removeprefix("EDITION_")
            return f'edition = "{edition}";'
        return f'syntax = "{self._syntax}";'

    def _imports(self) -> Iterator[str]:
        public, weak = set(self._file.public_dependency), set(self._file.weak_dependency)
        for index, name in enumerate(self._file.dependency):
            word = "public " if index in public else "weak " if index in weak else ""
            yield f"import {word}{option_text.quoted(name)};"

    # -- messages ------------------------------------------------------------------------------------------------------

    def _message(self, message: Any, path: Path, scope: str) -> list[str]:
        opening = f"message {message.name} {{"
        return [*self._comment(path), opening, *_indented(self._body(message, path, _joined(scope, message.name))), "}"]

    def _body(self, message: Any, path: Path, scope: str) -> list[str]:
        lines = [f"option {entry};" for entry in option_text.entries(message.options)]
        groups = {field.type_name.rpartition(".")[2] for field in message.field if field.type == _Field.TYPE_GROUP}
        lines += self._fields(message, path, scope)
        for index, inner in enumerate(message.nested_type):
            if not inner.options.map_entry and inner.name not in groups:
                lines += ["", *self._message(inner, (*path, INNER_MESSAGES, index), scope)]
        for index, enum in enumerate(message.enum_type):
            lines += ["", *self._enum(enum, (*path, _INNER_ENUMS, index))]
        for lines_of_extendee in self._extensions(message.extension, (*path, _INNER_EXTENSIONS), scope):
            lines += ["", *lines_of_extendee]
        for numbers in message.extension_range:
            lines.append(f"extensions {_range(numbers.start, numbers.end - 1)};")
        lines += _reserved(message, end_is_included=False)
        return lines

    def _fields(self, message: Any, path: Path, scope: str) -> Iterator[str]:
        """Yield the fields in their order; those of a oneof stand together where the first one does."""
        written: set[int] = set()
        for index, field in enumerate(message.field):
            if not _is_in_oneof(field):
                yield from self._field(field, (*path, FIELDS, index), scope, message)
            elif field.oneof_index not in written:
                written.add(field.oneof_index)
                yield from self._oneof(message, field.oneof_index, path, scope)

    def _oneof(self, message: Any, number: int, path: Path, scope: str) -> Iterator[str]:
        oneof = message.oneof_decl[number]
        yield from self._comment((*path, _ONEOFS, number))
        yield f"oneof {oneof.name} {{"
        for entry in option_text.entries(oneof.options):
            yield f"  option {entry};"
        for index, field in enumerate(message.field):
            if _is_in_oneof(field) and field.oneof_index == number:
                yield from _indented(self._field(field, (*path, FIELDS, index), scope, message))
        yield "}"

    def _field(self, field: Any, path: Path, scope: str, message: Any | None) -> Iterator[str]:
        yield from self._comment(path)
        options = option_text.of_field(field)
        if field.type == _Field.TYPE_GROUP:
            name = field.type_name.rpartition(".")[2]
            yield f"{self._label(field)}group {name} = {field.number}{options} {{"
            for index, inner in enumerate(message.nested_type if message is not None else ()):
                if inner.name == name:
                    inner_path = (*path[:-2], INNER_MESSAGES, index)
                    yield from _indented(self._body(inner, inner_path, _joined(scope, name)))
            yield "}"
            return
        type_ = self._map_type(field, scope, message) or f"{self._label(field)}{self._type(field, scope)}"
        yield f"{type_} {field.name} = {field.number}{options};"

    def _label(self, field: Any) -> str:
        if field.label == _Field.LABEL_REPEATED:
            return "repeated "
        if _is_in_oneof(field) or self._syntax == "editions":
            return ""
        if field.label == _Field.LABEL_REQUIRED:
            return "required "
        return "optional " if field.proto3_optional or self._syntax == "proto2" else ""

    def _type(self, field: Any, scope: str) -> str:
        if field.type_name:
            return self._names.short(field.type_name, scope)
        return str(_Field.Type.Name(field.type)).removeprefix("TYPE_").lower()

    def _map_type(self, field: Any, scope: str, message: Any | None) -> str | None:
        """Return the type of a map; None for other fields."""
        if field.type != _Field.TYPE_MESSAGE or field.label != _Field.LABEL_REPEATED or message is None:
            return None
        for inner in message.nested_type:
            if inner.options.map_entry and field.type_name == f".{_joined(scope, inner.name)}":
                key, value = sorted(inner.field, key=lambda part: part.number)[:2]
                return f"map<{self._type(key, scope)}, {self._type(value, scope)}>"
        return None

    # -- enums, extensions, services -----------------------------------------------------------------------------------

    def _enum(self, enum: Any, path: Path) -> Iterator[str]:
        yield from self._comment(path)
        yield f"enum {enum.name} {{"
        for entry in option_text.entries(enum.options):
            yield f"  option {entry};"
        for index, value in enumerate(enum.value):
            yield from _indented(self._comment((*path, _VALUES, index)))
            yield f"  {value.name} = {value.number}{option_text.bracketed(option_text.entries(value.options))};"
        yield from _indented(_reserved(enum, end_is_included=True))
        yield "}"

    def _extensions(self, extensions: Any, path: Path, scope: str) -> Iterator[list[str]]:
        """Yield the extensions of each message together."""
        for extendee in dict.fromkeys(field.extendee for field in extensions):
            lines = [f"extend {self._names.short(extendee, scope)} {{"]
            for index, field in enumerate(extensions):
                if field.extendee == extendee:
                    lines += _indented(self._field(field, (*path, index), scope, None))
            yield [*lines, "}"]

    def _service(self, service: Any, path: Path, scope: str) -> Iterator[str]:
        yield from self._comment(path)
        yield f"service {service.name} {{"
        for index, method in enumerate(service.method):
            yield from _indented(self._comment((*path, _METHODS, index)))
            takes = "stream " * method.client_streaming + self._names.short(method.input_type, scope)
            returns = "stream " * method.server_streaming + self._names.short(method.output_type, scope)
            yield f"  rpc {method.name}({takes}) returns ({returns});"
        yield "}"

    def _comment(self, path: Path) -> list[str]:
        # A compiler ends a comment at a NUL.
        lines = self._comments.get(path, "").replace("\0", "").rstrip().splitlines()
        return [f"// {line.strip()}".rstrip() for line in lines]


def _is_in_oneof(field: Any) -> bool:
    """Whether a field is one of several in the text. The compiler makes a oneof for each optional field besides."""
    return bool(field.HasField("oneof_index") and not field.proto3_optional)


def _reserved(described: Any, *, end_is_included: bool) -> list[str]:
    past = 0 if end_is_included else 1
    lines = [f"reserved {_range(numbers.start, numbers.end - past)};" for numbers in described.reserved_range]
    if described.reserved_name:
        names = ", ".join(orjson.dumps(name).decode() for name in described.reserved_name)
        lines.append(f"reserved {names};")
    return lines


def _range(start: int, last: int) -> str:
    if start == last:
        return str(start)
    return f"{start} to {'max' if last in (_LARGEST_NUMBER - 1, 2**31 - 1, 2**31 - 2) else last}"


def _joined(scope: str, name: str) -> str:
    return f"{scope}.{name}" if scope else name


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" if line else line for line in lines]
