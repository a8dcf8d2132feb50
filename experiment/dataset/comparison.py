"""From the journal of a session of comparisons to its rows: one for each pair that was laid out."""

from palpate.experiment.dataset.bids import Origin
from palpate.experiment.records.entries import Answer, Correction, MaskerSet, Redo
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.kinds.tapping import FIRST, SECOND, TIE, PairLaidOut

ANSWERS = {FIRST: "the material presented first", SECOND: "the one presented second", TIE: "neither of the two"}
"""What each answer names, as the sidecar tells it."""


def rows(contents: Contents, origin: Origin) -> list[dict[str, object]]:
    """Return a row for each attempt, by the columns of a comparison and some of the further ones."""
    entries, begun_ns = contents.entries, contents.lines[0].t_ns
    answers = {(one.trial, one.attempt): one for one in entries if isinstance(one, Answer)}
    corrections = {(one.trial, one.attempt): one for one in entries if isinstance(one, Correction)}
    redone = {(one.trial, one.attempt): one.reason for one in entries if isinstance(one, Redo)}
    masker: dict[str, object] = {}
    found: list[dict[str, object]] = []
    for entry in entries:
        if isinstance(entry, MaskerSet):
            masker = {"masker_level": entry.level_db_a}
        if not isinstance(entry, PairLaidOut):
            continue
        attempt = entry.trial, entry.attempt
        answer, correction = answers.get(attempt), corrections.get(attempt)
        last = correction or answer
        first, second = entry.presented
        found.append(
            {
                "onset": round((entry.laid_ns - begun_ns) / 1e9, 6),
                "trial": entry.trial,
                "attempt": entry.attempt,
                "counted": answer is not None and attempt not in redone,
                "first": first,
                "second": second,
                "answered": None if last is None else last.answered or NO_ANSWER,
                "response_time": round(answer.response_time_s, 6) if answer else None,
                "redo_reason": redone.get(attempt, None if answer else "no answer was confirmed"),
                "origin": origin,
                **({"corrected_from": answer.answered or NO_ANSWER} if answer and correction else {}),
                **masker,
            }
        )
    return found
