"""Decodes messages with ROS 1's own `genpy`; run with the system's Python.

    python3 decode_messages.py FILE

FILE is JSON: a list of types, definitions and messages in hexadecimal. Prints a JSON list of what they are.
"""

import json
import logging
import sys

from genpy.dynamic import generate_dynamic

logging.disable(logging.CRITICAL)


def main() -> None:
    with open(sys.argv[1]) as file:
        cases = json.load(file)
    found = []
    for name, definition, payload in cases:
        message = generate_dynamic(name, definition)[name]()
        message.deserialize(bytes.fromhex(payload))
        found.append(plain(message))
    print(json.dumps(found))


def plain(value):
    if hasattr(value, "__slots__") and not isinstance(value, (str, bytes)):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, bytes):
        return list(value)
    return [plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value


main()
