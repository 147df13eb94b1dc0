"""Reads moments as headers spell them: in the languages that Windows and Qt speak, with 12 or with 24 hours."""

from __future__ import annotations

import re
import unicodedata
import warnings
from pathlib import Path

from ...errors import ConversionWarning
from ..text.headers import seconds_at

_HALVES = (
    ("am", "pm"),
    ("a", "p"),
    ("上午", "下午"),
    ("上昼", "下昼"),
    ("上晝", "下晝"),
    ("午前", "午後"),
    ("오전", "오후"),
    ("fm", "em"),
    ("vm", "nm"),
    ("vorm", "nachm"),
    ("matin", "soir"),
    ("ap", "ip"),
    ("dop", "odp"),
    ("dop", "pop"),
    ("prp", "pop"),
    ("priešpiet", "popiet"),
    ("priekšp", "pēcp"),
    ("priekšpusdienā", "pēcpusdienā"),
    ("de", "du"),
    ("m", "p"),
    ("damanhã", "datarde"),
    ("manhã", "tarde"),
    ("delamañana", "delatarde"),
    ("πμ", "μμ"),
    ("öö", "ös"),
    ("дп", "пп"),
    ("проб", "слоб"),
    ("претпладне", "попладне"),
    ("претпл", "попл"),
    ("преподне", "поподне"),
    ("пријеподне", "поподне"),
    ("prepodne", "popodne"),
    ("prijepodne", "popodne"),
    ("үө", "үх"),  # noqa: RUF001 (letters of Mongolian)
    ("ص", "م"),
    ("قظ", "بظ"),
    ("قبلازظهر", "بعدازظهر"),
    ("לפנהצ", "אחהצ"),
    ("sa", "ch"),
    ("pg", "ptg"),
    ("ก่อนเที่ยง", "หลังเที่ยง"),
    ("पूर्वाह्न", "अपराह्न"),
    ("pd", "md"),
    ("eparadites", "epasdites"),
    ("fh", "eh"),
    ("yb", "yh"),
    ("rn", "in"),
)
"""The words for the two halves of a day in CLDR's languages that Windows has, without blanks and points."""

_MORNING = {before for before, _ in _HALVES}
_AFTERNOON = {after for _, after in _HALVES}
_DATES = (
    (re.compile(r"(\d{4})[-/.年](\d{1,2})[-/.月](\d{1,2})日?(?!\d)"), (1, 2, 3)),
    (re.compile(r"(?<!\d)(\d{1,2})\.(\d{1,2})\.(\d{4})(?!\d)"), (3, 2, 1)),
)
_TIME = re.compile(r"(?<!\d)(\d{1,2})[.,:](\d\d)[.,:](\d\d)(?:[.,:](\d{1,9}))?(?!\d)")


def read(path: Path, text: str, key: str, timezone: str) -> float | None:
    """Return the moment that a header names, in s since 1970; None if it names none.

    A text that is not understood draws a warning.

    Args:
        path: The file, for the warning.
        text: Such as "2019-09-18 04.30.02.695 PM", "2019-09-18 10.27.58.765 p. m.", "2019-09-18 16:30:02".
        key: What the header calls it.
        timezone: An IANA name.

    Raises:
        OptionError: There is no such time zone.
    """
    # Raises for an unknown time zone even if the header has no time: a wrong option must not depend on the file.
    seconds_at((2000, 1, 1, 0, 0, 0), "", timezone)
    if not text.strip():
        return None
    seconds = _seconds(text, timezone)
    if seconds is None:
        warnings.warn(
            f"{path}: {key} {text.strip()!r} is not understood, so the time stamps count from 0; pass start= to say"
            " the time stamp of the file's time 0",
            ConversionWarning,
            stacklevel=4,
        )
    return seconds


def _seconds(text: str, timezone: str) -> float | None:
    date, order = next(((match, order) for pattern, order in _DATES if (match := pattern.search(text))), (None, ()))
    if date is None:
        return None
    rest = text[: date.start()] + " " + text[date.end() :]
    time = _TIME.search(rest)
    if time is None:
        return None
    words = _plain(rest[: time.start()] + rest[time.end() :])
    hour = int(time[1])
    if words in _AFTERNOON | _MORNING:
        if not 0 <= hour <= 12 and words in _MORNING:
            return None
        # 12 AM is midnight and 12 PM is noon.
        hour = hour % 12 + 12 * (words in _AFTERNOON)
    elif words:
        return None
    year, month, day = (int(date[at]) for at in order)
    return seconds_at((year, month, day, hour, int(time[2]), int(time[3])), time[4] or "", timezone)


def _plain(text: str) -> str:
    """Return a word in lower case, without blanks, points, commas and quotes of any kind."""
    composed = unicodedata.normalize("NFC", text.casefold())
    return "".join(letter for letter in composed if unicodedata.category(letter)[0] in "LM")
