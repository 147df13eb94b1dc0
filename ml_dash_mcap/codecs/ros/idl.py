"""Parses message definitions in the part of OMG IDL that ROS 2 uses."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ...errors import EncodingError
from . import definitions, interfaces
from .definitions import Find, LookedUp, closure, nowhere
from .message_types import (
    APPENDABLE,
    MUTABLE,
    STRING,
    Array,
    Basic,
    Definitions,
    Fields,
    Named,
    Optional,
    Type,
    Undecoded,
    canonical,
    shortened,
)

_SECTION = re.compile(r"^={3,}[ \t]*\r?\n(?:IDL:[^\n]*\n)?|^IDL:[^\n]*\n", re.MULTILINE)
_TOKEN = re.compile(
    # An alternative without a name is skipped: blanks, comments, also an unclosed one, and `#include` lines, which
    # recordings carry.
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

# Definitions come from foreign files: this and the limits of 16 below keep a hostile one from nesting without end.
_MOST_BASES = 100
_ENUMS = {1: "uint8", 2: "uint16", 4: "uint32"}
"""Bytes of an enumeration, to the number that stands for it."""
_KINDS = {"final": "final", "appendable": APPENDABLE, "extensible": APPENDABLE, "mutable": MUTABLE}
"""Annotations that say whether a struct can grow (https://www.omg.org/spec/DDS-XTypes/1.3, section 7.3.1.2.1.8)."""
_NOT_DECODED = frozenset({"wstring", "wchar", "long double", "map", "fixed", "any"})


def parse(name: str, text: str, *, is_ros: bool = True, find: Find = nowhere) -> Definitions:
    """Read a definition and those that it needs, in one text, each perhaps under a line `IDL: pkg/msg/Name`.

    Args:
        name: Of the message.
        text: IDL.
        is_ros: Whether a struct without members has a byte on the wire, as ROS 2 sends it.
        find: Looks up messages that the text lacks.

    Raises:
        EncodingError: It is no IDL, or lacks a message that is used.
    """
    parser = _Parser(_SECTION.sub("\n", text), find)
    parser.read(())
    root = canonical(name)
    messages = closure(root, parser.fields)
    return Definitions(root, messages, parser.extensibility, is_ros)


Scope = tuple[str, ...]
"""The modules around something, the outermost first."""


class _Parser:
    """Reads the tokens of a text one by one and keeps the definitions in tables, by scoped name."""

    def __init__(self, text: str, find: Find) -> None:
        self._tokens = _tokens(text)
        self._find = find
        self._token = ""
        self._structs: dict[str, Fields] = {}
        self._by_short: dict[str, list[str]] = {}
        """Structs by their shortened names: the first part and the last one."""
        self._bases: dict[str, str] = {}
        """Structs to the structs that they inherit members from."""
        self.extensibility: dict[str, str] = {}
        """Structs to the extensibility that their annotations state."""
        self._named: dict[Scope, Type] = {}
        """Typedefs, enums, structs and unions."""
        self._constants: dict[Scope, int] = {}
        self._advance()

    def fields(self, message: str) -> Fields:
        """Return a struct's members, those of its base first.

        Raises:
            EncodingError: There is no such struct.
        """
        members: dict[str, Type] = {}
        current: str | None = message
        seen: set[str] = set()
        while current is not None:
            own = self._own_fields(current)
            if current in seen or len(seen) > _MOST_BASES:
                raise EncodingError(f"{message} has itself for a base, or too many of them")
            if double := members.keys() & own.keys():
                raise EncodingError(f"{message} has two fields {min(double)!r}")
            members = {**own, **members}
            seen.add(current)
            current = self._bases.get(current)
        return members

    def _own_fields(self, message: str) -> Fields:
        if message in self._structs:
            return self._structs[message]
        short = shortened(message)
        same = self._by_short.get(short, []) if message == short else [short] if short in self._structs else []
        if len(same) == 1:
            return self._structs[same[0]]
        text = interfaces.KNOWN.get(message) or interfaces.around(message, self._structs)
        looked_up = LookedUp(text) if text is not None else self._find(message)
        if looked_up is None:
            raise EncodingError(f"it does not define {message}")
        if message in looked_up.messages:
            return looked_up.messages[message]
        return definitions.parse(message, looked_up.text, find=self._known).messages[message]

    def _known(self, message: str) -> LookedUp | None:
        """Look up a message for a text that was looked up."""
        if message in self._structs:
            return LookedUp(messages={message: self.fields(message)})
        return self._find(message)

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
        """Skip to the mark that closes the opening mark just taken."""
        depth = 1
        while depth:
            token = self._advance()
            if not token:
                raise EncodingError(f"its IDL ends where {closing!r} should be")
            depth += (token == opening) - (token == closing)

    # -- what stands in a module ---------------------------------------------------------------------------------------

    def read(self, scope: Scope) -> None:
        while self._token and self._token != "}":
            annotations = self._annotations()
            kind = self._word()
            if kind == "module":
                inner = (*scope, self._word())
                if len(inner) > 16:
                    raise EncodingError("its IDL has modules in modules in modules")
                self._expect("{")
                self.read(inner)
                self._expect("}")
            elif kind == "struct":
                self._struct((*scope, self._word()), annotations)
            elif kind == "typedef":
                for name, type_ in self._declared(scope):
                    scoped = (*scope, name)
                    self._named[scoped] = type_
            elif kind == "const":
                self._constant(scope)
            elif kind in ("enum", "union", "bitmask", "bitset"):
                self._other(kind, scope, annotations)
            else:
                raise EncodingError(f"its IDL has a {kind!r}, which ROS 2 does not use")
            self._expect(";")

    def _annotations(self) -> dict[str, str]:
        """Read annotations; returns their names in lower case, and the first word or number of what is in brackets."""
        arguments: dict[str, str] = {}
        while self._takes("@"):
            name = self._scoped()[-1].lower()
            arguments[name] = ""
            if self._takes("("):
                arguments[name] = self._token.lower()
                self._skip("(", ")")
        return arguments

    def _struct(self, scoped: Scope, annotations: Mapping[str, str]) -> None:
        message = canonical("/".join(scoped))
        self._named[scoped] = Named(message)
        if self._token == ";":
            return  # only announced
        kinds = [_KINDS[name] for name in (annotations.get("extensibility", ""), *annotations) if name in _KINDS]
        if kinds:
            self.extensibility[message] = kinds[0]
        if self._takes(":"):
            base = self._lookup(self._scoped(), scoped[:-1])
            if not isinstance(base, Named):
                raise EncodingError(f"{message} has a base that is no struct")
            self._bases[message] = base.name
        fields: dict[str, Type] = {}
        self._expect("{")
        while not self._takes("}"):
            is_optional = self._annotations().get("optional", "false") in ("", "true")
            for name, type_ in self._declared(scoped[:-1]):
                if name in fields:
                    raise EncodingError(f"{message} has two fields {name!r}")
                fields[name] = Optional(type_) if is_optional else type_
            self._expect(";")
        if message in self._structs and list(self._structs[message].items()) != list(fields.items()):
            raise EncodingError(f"it defines {message} more than once, with other members each time")
        if message not in self._structs:
            self._by_short.setdefault(shortened(message), []).append(message)
        self._structs[message] = fields

    def _other(self, kind: str, scope: Scope, annotations: Mapping[str, str]) -> None:
        scoped = (*scope, self._word())
        # An enumeration has 32 bits unless @bit_bound says otherwise (DDS-XTypes 1.3, section 7.3.1.2.1).
        bits = _integer(annotations.get("bit_bound", "32")) or 0
        size = next((size for size in _ENUMS if bits <= 8 * size), None)
        is_enum = kind == "enum" and size is not None and bits > 0
        self._named[scoped] = (
            Basic(_ENUMS[size or 4], is_enum=True) if is_enum else Undecoded(f"{kind} {'::'.join(scoped)}")
        )
        while self._token and self._token != "{":
            self._advance()
        self._expect("{")
        self._skip("{", "}")

    def _constant(self, scope: Scope) -> None:
        while self._token and self._token != "=":
            name = self._advance()
        self._expect("=")
        value = self._advance()
        # Only plain integers are kept: a constant matters here only as the length of an array.
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
        if self._token not in ("sequence", "string", "unsigned", "long", *_BASIC, *_NOT_DECODED):
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
        if word in _NOT_DECODED:
            if self._takes("<"):
                self._skip("<", ">")
            return Undecoded(word)
        if word not in _BASIC:
            raise EncodingError(f"its IDL has the type {word!r}, which there is not")
        return Basic(_BASIC[word])

    def _length(self, scope: Scope) -> int:
        number = _integer(self._token)
        if number is not None:
            self._advance()
            return number
        name = self._scoped()
        for at in range(len(scope), -1, -1):
            # IDL looks a name up in the innermost module first and then outwards.
            constant = self._constants.get((*scope[:at], *name))
            if constant is not None:
                return constant
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
                return self._named[scoped]
        return Named(canonical("/".join(name if len(name) > 1 else (*scope, *name))))


def _tokens(text: str) -> Iterator[str]:
    for match in _TOKEN.finditer(text):
        if match.lastgroup:
            yield match.group()


def _integer(token: str) -> int | None:
    try:
        number = int(token, 0)
    except ValueError:
        return None
    return number if number >= 0 else None
