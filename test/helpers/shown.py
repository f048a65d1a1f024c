"""What a page shows as printed, against what is printed: words are the same, numbers the same up to one unit of their last digit."""

from __future__ import annotations

import re

NUMBER = re.compile(r"(?P<before>\(?)(?P<number>-?\d+(?:\.\d+)?)(?P<after>[.,:;)]*)")
FRAMES = str.maketrans(dict.fromkeys("┃━╇│┼─╈┆", " "))  # of tables


def words_of(text: str) -> list[str]:
    """Split a text at its white space, wherever its lines were broken, without the frames of tables; times of computing become T."""
    plain = " ".join(text.translate(FRAMES).split())
    return re.sub(r"(planned in|planning time \[s\]) [\d.]+", r"\1 T", plain).split()


def same(shown: str, printed: str) -> bool:
    """Whether a word is the one that the page shows."""
    a, b = NUMBER.fullmatch(shown), NUMBER.fullmatch(printed)
    if a is None or b is None:
        return shown == printed
    digits = len(a["number"].partition(".")[2])
    whole = digits == 0  # a count, a seed
    near = abs(float(a["number"]) - float(b["number"])) <= (0.0 if whole else 1.01 * 10.0**-digits)
    return near and (a["before"], a["after"], digits) == (b["before"], b["after"], len(b["number"].partition(".")[2]))


def is_shown(shown: str, printed: str) -> bool:
    """Whether the page shows what is printed, all of it; `...` stands for any words."""
    parts: list[list[str]] = [[]]
    for word in words_of(shown):
        if word == "...":
            parts.append([])
        else:
            parts[-1].append(word)
    words = words_of(printed)
    at = 0
    for number, part in enumerate(parts):
        end = len(words) - len(part)
        first = at if number < len(parts) - 1 else max(at, end)  # the last part ends the text
        places = [0] if number == 0 and end >= 0 else range(first, end + 1)
        found = [k for k in places if all(map(same, part, words[k : k + len(part)]))]
        if not found:
            return False
        at = found[0] + len(part)
    return at == len(words)
