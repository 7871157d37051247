#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Check that pages and comments use the words of docs/glossary.md and plain sentences.

usage: check_words.py [--all] [ROOT]     (ROOT: the repository, by default the one that this file is in)

Reads the Markdown of docs/, include/, tools/ and of the repository itself, and the comments and docstrings of
include/, src/, examples/, tools/ and tests/; of C++ the identifiers as well. Prints one line for each
finding: file, line, what was found, what to write instead. Files of NOT_YET are skipped, unless --all is
given; one of them that has no finding any more is a finding itself, so that the list shrinks.
Exit status: 0 none, 1 some, 2 nothing to read at ROOT.
"""

from __future__ import annotations

import io
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

# What is not written, as a regular expression, and what is written instead. Case does not matter.
SENTENCES = {
    r"\bwhoever\b": "say who: the caller, the user, a thread",
    r"\bnobody\b|\bno one\b": "say what does not: no caller, no beam, no scan",
    r"\bso many\b": "this many, n, or the number's name",
    r"\bof (which|these|those)\b[^.;:]{0,60}\bthose (that|which|whose)\b": "two sentences with nouns",
    r"\bof [^.;:,]{1,50}, those (that|which|whose)\b": "name them: 'the beams of a list that ...'",
    r"\bfrom the first to before the last\b": "[first, last)",
    r"\bin vain\b": "predicted to re-merge; or: without success",
    r"\bheirs\b|\bheritage\b": "children; child initialisation",
    r"\b(un)?settled\b": "saturated",
    r"\bhand(s|ed|ing)? (\w+ )?down\b": "partition (lists); pass; initialise (children)",
    r"\bbr(ing|ings|inging|ought)\b[^.;:]{0,40}\b(in)?to\b[^.;:]{0,30}\bcells?\b": "bin",
    r"\bshar(e|es|ed|ing) (\w+ ){0,2}out\b": "divide, distribute",
    r"\blook(s|ed|ing)? over\b": "survey",
    r"\bfall(s|ing)? asleep\b|\b(stay|stays|are|is) awake\b": "sleep; spin",
    r"\blone\b": "single (beam, ray)",
    r"\bclosed lists?\b|\blists? (is|are) closed\b": "padded list",
    r"\b(cells?|leaf|leaves|nodes?|siblings?|child|children|parents?) (that |which )?(knows?|knew)\b": (
        "has evidence; is well observed"
    ),
    r"\bknows? (\w+ )?(nothing|so much|free space|much)\b": "has no evidence; is well observed; is free",
    r"\bbeams? (says?|said|tells?|told) ": "a beam's evidence; a beam measures",
    r"\bwhat (a|the|all|its|his) beams? (says?|said|tells?|told)\b": "a beam's evidence",
    r"(^|[.;:] )Who (asks|wants|waits|needs|calls|has|uses|builds|links|writes|reads|works)\b[^?]*$": (
        "say who: a caller that asks, users who build"
    ),
    r"\bis (told|known) of\b": "has; is given",
    r"\b(a|the|another|two|both|other|of) (maps?|layers?|trees?) knows?\b": "holds; has observed",
    r"\bof which (nothing|anything) is known\b": "unknown; without evidence",
    r"\brooms, each of\b|\bhas rooms\b": "layers, packages",
}
# How a comment does not begin.
BEGINNINGS = {
    r"\.\.\. ": "a comment is understood without the one before it",
    r"The same (of|for|with|by|as|but|in|to|once|again|from|if|when|on)\b": "say what it does",
}
# Parts of C++ identifiers, where case matters.
IDENTIFIERS = {
    r"\w*settled\w*|\w*Settled\w*": "saturated",
    r"(?<!t)heirs\w*|\w+_heirs\b|\w*heritage\w*|\w*Heritage\w*|\binherited\b|\bInheritance\b": (
        "child initialisation, initial_child"
    ),
    r"\w*in_vain\w*": "predicted_to_remerge",
    r"\bupdate_whole\b": "update_without_split",
    r"\blone\w*|\bLone\w*|\w+_lone\b": "single",
    r"\bis_known\b": "is_well_observed (a cell), is_valid (a summary)",
}

# Not in these words yet. A file leaves the list as soon as it is clean; a folder when all of it is.
NOT_YET: set[str] = set()

PAGES = ("README.md", "CONTRIBUTING.md", "docs/*.md", "include/**/*.md", "tools/**/*.md")
CODE = ("include", "src", "examples", "tools", "tests")
CPP = {".hpp", ".cpp", ".h"}
PYTHON = {".py", ".pyi"}


#: Line, text, and whether it is a comment.
Paragraph = tuple[int, str, bool]


def empty_lines(found: re.Match[str]) -> str:
    """As many lines as were found, so that the others keep their numbers."""
    return "\n" * found[0].count("\n")


def texts_of_page(text: str) -> Iterator[Paragraph]:
    """Paragraphs of Markdown without code: line, text, whether it is a comment."""
    text = re.sub(
        r"^```.*?^```$", lambda found: "\n" * found[0].count("\n"), text, flags=re.DOTALL | re.MULTILINE
    )
    text = re.sub(r"`[^`\n]*`", "`", text)
    yield from paragraphs(enumerate(text.splitlines(), start=1), is_comment=False)


def paragraphs(lines: Iterable[tuple[int, str]], is_comment: bool) -> Iterator[Paragraph]:
    """Lines that follow each other without an empty one between them, as one text."""
    first, before = 0, -1
    gathered: list[str] = []
    for number, line in [*lines, (sys.maxsize, "")]:
        stripped = line.strip()
        if gathered and (not stripped or number != before + 1):
            yield first, "\n".join(gathered), is_comment
            gathered = []
        if stripped:
            if not gathered:
                first = number
            gathered.append(stripped)
            before = number


CPP_TOKEN = re.compile(
    r'R"\((.*?)\)"|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'|//[^\n]*|/\*.*?\*/', re.DOTALL
)


def comments_of_cpp(text: str) -> Iterator[Paragraph]:
    lines: list[tuple[int, str]] = []
    for found in CPP_TOKEN.finditer(text):
        if not found[0].startswith("/"):
            continue
        number = text.count("\n", 0, found.start()) + 1
        if text[text.rfind("\n", 0, found.start()) + 1 : found.start()].strip():  # Behind code.
            yield from paragraphs(lines, is_comment=True)
            lines = []
        for more, line in enumerate(found[0].splitlines()):
            lines.append((number + more, re.sub(r"^\s*(//+<?|/\*+|\*+/?)\s?(@file\b)?|\*/\s*$", "", line)))
    yield from paragraphs(lines, is_comment=True)


def code_of_cpp(text: str) -> str:
    """The text without comments and strings, line for line."""
    return CPP_TOKEN.sub(empty_lines, text)


def comments_of_python(text: str) -> Iterator[Paragraph]:
    lines: list[tuple[int, str]] = []
    try:
        before = tokenize.NEWLINE
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                lines.append((token.start[0], token.string.lstrip("#: ")))
            elif token.type == tokenize.STRING and before in (tokenize.NEWLINE, tokenize.INDENT):
                for more, line in enumerate(token.string.strip("rR\"'").splitlines()):
                    lines.append((token.start[0] + more, line))
            if token.type not in (tokenize.COMMENT, tokenize.NL, tokenize.DEDENT):
                before = token.type
    except tokenize.TokenError:
        pass
    yield from paragraphs(lines, is_comment=True)


def comments_of_script(text: str) -> Iterator[Paragraph]:
    lines = [
        (number, found[1])
        for number, line in enumerate(text.splitlines(), start=1)
        if (found := re.search(r"(?:^|\s)#(?!!)\s?(.*)$", line))
    ]
    yield from paragraphs(lines, is_comment=True)


def findings_in(name: str, text: str) -> Iterator[tuple[int, str, str]]:
    """Line, what was found, and what to write instead."""
    suffix = Path(name).suffix
    is_python = suffix in PYTHON or (not suffix and text.startswith("#!") and "python" in text[:40])
    if suffix == ".md":
        texts = texts_of_page(text)
    elif suffix in CPP:
        texts = comments_of_cpp(text)
    elif is_python:
        texts = comments_of_python(text)
    else:
        texts = comments_of_script(text)
    for first, paragraph, is_comment in texts:
        for pattern, better in SENTENCES.items():
            for found in re.finditer(pattern.replace(" ", r"\s+"), paragraph, re.IGNORECASE):
                yield first + paragraph.count("\n", 0, found.start()), " ".join(found[0].split()), better
        if is_comment:
            for pattern, better in BEGINNINGS.items():
                if begin := re.match(pattern, paragraph):
                    yield first, begin[0].strip(), better
    if suffix in CPP:
        for number, line in enumerate(code_of_cpp(text).splitlines(), start=1):
            for pattern, better in IDENTIFIERS.items():
                for found in re.finditer(pattern, line):
                    yield number, found[0], better


def files_of(root: Path) -> Iterator[str]:
    """Names of the files that are read, relative to the root."""
    for pattern in PAGES:
        yield from sorted(path.relative_to(root).as_posix() for path in root.glob(pattern))
    for folder in CODE:
        for path in sorted((root / folder).rglob("*")):
            name = path.relative_to(root).as_posix()
            is_text = path.suffix in {*CPP, *PYTHON, ".cmake", ".sh", ".txt"}
            if path.is_file() and "__pycache__" not in name and path.name != "check_words.py":
                if is_text or (not path.suffix and path.read_bytes()[:2] == b"#!"):
                    yield name


def is_in(name: str, listed: str) -> bool:
    """Whether a file is the listed one, or in the listed folder."""
    return name == listed or (listed.endswith("/") and name.startswith(listed))


def check(root: Path, skip: bool = True) -> tuple[int, list[str]]:
    """How many files were read, and a line for each finding."""
    lines: list[str] = []
    left: dict[str, int] = dict.fromkeys(NOT_YET, 0)
    count = 0
    for name in files_of(root):
        count += 1
        found = sorted(set(findings_in(name, (root / name).read_text(encoding="utf-8"))))
        listed = next(
            (one for one in NOT_YET if name == one or (one.endswith("/") and name.startswith(one))), None
        )
        if listed is not None:
            left[listed] += len(found)
            if skip:
                continue
        lines += [f"{name}:{line}: {what!r}: write {better}" for line, what, better in found]
    lines += [
        f"tools/check_words.py: NOT_YET lists {one}, which has no finding: take it from the list"
        for one, number in sorted(left.items())
        if number == 0
    ]
    return count, lines


def main(arguments: list[str]) -> int:
    skip = "--all" not in arguments
    names = [argument for argument in arguments if argument != "--all"]
    root = Path(names[0]) if names else Path(__file__).resolve().parents[1]
    count, lines = check(root, skip)
    if count == 0:
        print(f"check_words.py: {root}: no pages and no code there", file=sys.stderr)
        return 2
    print("\n".join(lines) if lines else f"{count} files: no word that the glossary has a better one for")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
