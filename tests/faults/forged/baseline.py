"""Writes and compares what `palpate verify` reports of the forged datasets: `python -m tests.faults forged OUT`.

In a `.jsonl` file a record is one line, with every finding. In a `.txt` file, such as `baseline.txt`, a clean dataset
has every finding, and a forged one what is new (+) and what is gone (-) against it, and what follows (=).
"""

from __future__ import annotations

import argparse
import difflib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.faults.forged.records import Line, Record, run

BASELINE = Path(__file__).with_name("baseline.txt")

Blocks = dict[str, list[str]]
"""The lines of each record, by number, forgery and clean dataset."""


def name(record: Record) -> str:
    """Return what a record is known by."""
    return f"{record.number:03d} {record.forgery} | {record.base}"


def whole(records: Iterable[Record]) -> Blocks:
    """Return every finding of each record."""
    return {
        name(one): [_end(one), *(f"  {finding}" for finding in one.findings), *(f"= {text}" for text in one.sentences)]
        for one in records
    }


def compact(records: Iterable[Record]) -> Blocks:
    """Return every finding of clean datasets, and of forged ones what differs; the clean ones come first."""
    blocks: Blocks = {}
    clean: dict[str, Record] = {}
    for one in records:
        before = clean.setdefault(one.base, one)
        if one is before:
            blocks |= whole([one])
            continue
        # Where nothing could be checked, every finding is gone.
        gone = [] if one.code == 2 else [finding.where for finding in before.findings if finding not in one.findings]
        blocks[name(one)] = [
            _end(one),
            *(f"+ {finding}" for finding in one.findings if finding not in before.findings),
            *([f"- {', '.join(gone)}"] if gone else []),
            *(f"= {text}" for text in one.sentences if text not in before.sentences),
        ]
    return blocks


def _end(record: Record) -> str:
    """Return the end of a title: where the dataset was forged, and the exit code."""
    return " | ".join([*record.places, f"exit {record.code}"])


def read_text(path: Path) -> Blocks:
    """Return the records of a `.txt` file."""
    blocks: Blocks = {}
    for line in path.read_text("utf-8").splitlines():
        if line[:3].isdecimal():
            number_and_forgery, base, end = line.split(" | ", 2)
            lines = blocks[f"{number_and_forgery} | {base}"] = [end]
        else:
            lines.append(line)
    return blocks


def write_text(path: Path, blocks: Blocks) -> None:
    """Write records as `read_text` reads them."""
    lines = (line for known_by, (end, *rest) in blocks.items() for line in (f"{known_by} | {end}", *rest))
    path.write_text("".join(f"{line}\n" for line in lines), "utf-8")


def read_json(path: Path) -> list[Record]:
    """Return the records of a `.jsonl` file."""
    return [_record(json.loads(line)) for line in path.read_text("utf-8").splitlines()]


def _record(facts: dict[str, Any]) -> Record:
    findings = tuple(Line(**finding) for finding in facts["findings"])
    places, sentences = tuple(facts["places"]), tuple(facts["sentences"])
    return Record(**{**facts, "findings": findings, "places": places, "sentences": sentences})


def write_json(path: Path, records: Iterable[Record]) -> None:
    """Write records as `read_json` reads them."""
    lines = (json.dumps(asdict(record), ensure_ascii=False) for record in records)
    path.write_text("".join(f"{line}\n" for line in lines), "utf-8")


def differences(before: Blocks, now: Blocks) -> Iterator[str]:
    """Yield the name of each record that differs, and its lines before (<) and now (>)."""
    for known_by in dict.fromkeys((*before, *now)):
        pair = before.get(known_by, []), now.get(known_by, [])
        if pair[0] != pair[1]:
            yield known_by
            for line in difflib.ndiff(*pair):
                if line[0] in "-+":
                    yield f"  {'<' if line[0] == '-' else '>'} {line[2:]}"


def main(arguments: Sequence[str]) -> int:
    """Run every forgery, write the records, and return 1 if they differ from others, 0 otherwise."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults forged", description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT", help="a file to write: .jsonl, or .txt for the short form")
    parser.add_argument("--against", type=Path, metavar="FILE", help="a file of either form to compare with")
    asked = parser.parse_args(arguments)
    records = run()
    if asked.out.suffix == ".txt":
        write_text(asked.out, compact(records))
    else:
        write_json(asked.out, records)
    if asked.against is None:
        return 0
    short = asked.against.suffix == ".txt"
    before = read_text(asked.against) if short else whole(read_json(asked.against))
    differing = list(differences(before, compact(records) if short else whole(records)))
    print(*differing, sep="\n", end="\n" * bool(differing))
    return int(bool(differing))
