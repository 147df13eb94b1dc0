"""Message definitions in the part of OMG IDL that ROS 2 uses."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ..errors import EncodingError
from . import definitions, interfaces
from .message_types import STRING, Array, Basic, Definitions, Fields, Named, Type, canonical

_SECTION = re.compile(r"^={3,}[ \t]*\r?\n(?:IDL:[^\n]*\n)?|^IDL:[^\n]*\n", re.MULTILINE)
_TOKEN = re.compile(
    r"""\s+ | //[^\n]* | /\*(?:.*?\*/|.*) | ^[ \t]*\#[^\n]*      # nothing
      | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<number>[+-]?\.?[0-9][A-Za-z0-9_.]*)
      | (?P<text>L?"(?:\\.|[^"\\])*"|L?'(?:\\.|[^'\\])*')
      | (?P<mark>::|.)""",
    re.VERBOSE | re.MULTILINE | re.DOTALL,
)

_BASIC: Mapping[str, str] = {
    "boolean": "bool",
    "octet": "uint8",
    "char": "uint8",
    "int8": "int8",
    "uint8": "uint8",
    "short": "int16",
    "int16": "int16",
    "unsigned short": "uint16",
    "uint16": "uint16",
    "long": "int32",
    "int32": "int32",
    "unsigned long": "uint32",
    "uint32": "uint32",
    "long long": "int64",
    "int64": "int64",
    "unsigned long long": "uint64",
    "uint64": "uint64",
    "float": "float32",
    "double": "float64",
    "string": STRING,
}
"""https://design.ros2.org/articles/idl_interface_definition.html, section "Basic types"."""

_ENUM = Basic("uint32")
_REFUSED = frozenset({"wstring", "wchar", "long double", "map", "fixed", "any", "union"})


def parse(name: str, text: str) -> Definitions:
    """Read a definition and those that it needs, in one text, each perhaps under a line `IDL: pkg/msg/Name`.

    Args:
        name: Of the message.
        text: IDL.

    Raises:
        EncodingError: It is no IDL, uses what ROS 2 does not, or lacks a message that is used.
    """
    parser = _Parser(_SECTION.sub("\n", text))
    parser.read(())
    root = canonical(name)
    messages: dict[str, Fields] = {}
    waiting = [root]
    while waiting:
        current = waiting.pop()
        if current not in messages:
            messages[current] = parser.fields(current)
            inner = map(definitions.message_in, messages[current].values())
            waiting += [one for one in inner if one is not None]
    return Definitions(root, messages)


Scope = tuple[str, ...]
"""The modules around something, the outermost first."""


class _Parser:
    """Reads tokens one by one; what it finds is in its tables, by scoped name."""

    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text)
        self._token = ""
        self._structs: dict[str, Fields] = {}
        self._named: dict[Scope, Type | None] = {}
        """Typedefs, enums, structs and unions; None for what ROS 2 does not use."""
        self._constants: dict[Scope, int] = {}
        self._advance()

    def fields(self, message: str) -> Fields:
        if message in self._structs:
            return self._structs[message]
        if message in interfaces.KNOWN:
            return definitions.parse(message, interfaces.KNOWN[message]).messages[message]
        raise EncodingError(f"it does not define {message}")

    # -- tokens --------------------------------------------------------------------------------------------------------

    def _advance(self) -> str:
        token, self._token = self._token, next(self._tokens, "")
        return token

    def _takes(self, *tokens: str) -> bool:
        if self._token in tokens:
            self._advance()
            return True
        return False

    def _expect(self, token: str) -> None:
        if not self._takes(token):
            raise EncodingError(f"its IDL has {self._token or 'its end'!r} where {token!r} should be")

    def _word(self) -> str:
        if not (self._token[:1].isalpha() or self._token[:1] == "_"):
            raise EncodingError(f"its IDL has {self._token or 'its end'!r} where a name should be")
        return self._advance()

    def _skip(self, opening: str, closing: str) -> None:
        """Skip to the mark that closes the one that was just taken."""
        depth = 1
        while depth:
            token = self._advance()
            if not token:
                raise EncodingError(f"its IDL ends where {closing!r} should be")
            depth += (token == opening) - (token == closing)

    # -- what stands in a module ---------------------------------------------------------------------------------------

    def read(self, scope: Scope) -> None:
        while self._token and self._token != "}":
            self._annotations()
            kind = self._word()
            if kind == "module":
                inner = (*scope, self._word())
                if len(inner) > 16:
                    raise EncodingError("its IDL has modules in modules in modules")
                self._expect("{")
                self.read(inner)
                self._expect("}")
            elif kind == "struct":
                self._struct((*scope, self._word()))
            elif kind == "typedef":
                for name, type_ in self._declared(scope):
                    scoped = (*scope, name)
                    self._named[scoped] = type_
            elif kind == "const":
                self._constant(scope)
            elif kind in ("enum", "union", "bitmask", "bitset"):
                self._other(kind, (*scope, self._word()))
            else:
                raise EncodingError(f"its IDL has a {kind!r}, which ROS 2 does not use")
            self._expect(";")

    def _annotations(self) -> None:
        while self._takes("@"):
            name = self._scoped()
            if name == ("optional",):
                raise EncodingError("its IDL has an @optional member, which ROS 2 does not use")
            if self._takes("("):
                self._skip("(", ")")

    def _struct(self, scoped: Scope) -> None:
        message = canonical("/".join(scoped))
        self._named[scoped] = Named(message)
        if self._token == ";":
            return  # only announced
        fields: dict[str, Type] = {}
        self._expect("{")
        while not self._takes("}"):
            self._annotations()
            for name, type_ in self._declared(scoped[:-1]):
                if name in fields:
                    raise EncodingError(f"{message} has two fields {name!r}")
                fields[name] = type_
            self._expect(";")
        self._structs[message] = fields

    def _other(self, kind: str, scoped: Scope) -> None:
        self._named[scoped] = _ENUM if kind == "enum" else None
        while self._token and self._token != "{":
            self._advance()
        self._expect("{")
        self._skip("{", "}")

    def _constant(self, scope: Scope) -> None:
        while self._token and self._token != "=":
            name = self._advance()
        self._expect("=")
        value = self._advance()
        if self._token == ";" and (number := _integer(value)) is not None:
            scoped = (*scope, name)
            self._constants[scoped] = number
        while self._token and self._token != ";":
            self._advance()

    # -- types ---------------------------------------------------------------------------------------------------------

    def _declared(self, scope: Scope) -> Iterator[tuple[str, Type]]:
        """Read a type and the names that get it, each perhaps with lengths of its own."""
        type_ = self._type(scope, 0)
        while True:
            name, lengths = self._word(), list[int]()
            while self._takes("["):
                lengths.append(self._length(scope))
                self._expect("]")
            of = type_
            for length in reversed(lengths):
                of = Array(of, length)
            yield name, of
            if not self._takes(","):
                return

    def _type(self, scope: Scope, depth: int) -> Type:
        if depth > 16:
            raise EncodingError("its IDL has sequences of sequences of sequences")
        if self._token == "::":
            return self._lookup(self._scoped(), scope)
        if self._token not in ("sequence", "string", "unsigned", "long", *_BASIC, *_REFUSED):
            return self._lookup(self._scoped(), scope)
        word = self._word()
        if word == "sequence":
            self._expect("<")
            of = self._type(scope, depth + 1)
            if self._takes(","):
                self._length(scope)
            self._expect(">")
            return Array(of, None)
        while word in ("unsigned", "long", "unsigned long") and self._token in ("long", "short", "double"):
            word += " " + self._advance()
        if word == "string" and self._takes("<"):
            self._length(scope)
            self._expect(">")
        if word not in _BASIC:
            raise EncodingError(f"it has the type {word!r}, which cannot be decoded")
        return Basic(_BASIC[word])

    def _length(self, scope: Scope) -> int:
        number = _integer(self._token)
        if number is not None:
            self._advance()
            return number
        name = self._scoped()
        for at in range(len(scope), -1, -1):
            found = self._constants.get((*scope[:at], *name))
            if found is not None:
                return found
        raise EncodingError(f"its IDL has the length {'::'.join(name)}, which is no plain number or constant")

    def _scoped(self) -> Scope:
        self._takes("::")
        names = [self._word()]
        while self._takes("::"):
            names.append(self._word())
        return tuple(names)

    def _lookup(self, name: Scope, scope: Scope) -> Type:
        for at in range(len(scope), -1, -1):
            scoped = (*scope[:at], *name)
            if scoped in self._named:
                found = self._named[scoped]
                if found is None:
                    raise EncodingError(f"it has the type {'::'.join(name)}, which cannot be decoded")
                return found
        return Named(canonical("/".join(name if len(name) > 1 else (*scope, *name))))


def _tokens(text: str) -> Iterator[str]:
    for found in _TOKEN.finditer(text):
        if found.lastgroup:
            yield found.group()


def _integer(token: str) -> int | None:
    try:
        number = int(token, 0)
    except ValueError:
        return None
    return number if number >= 0 else None
