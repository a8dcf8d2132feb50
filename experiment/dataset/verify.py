"""`palpate verify`: what a dataset shows about itself, and what only a register outside of it can show.

Journals, heads and tables show accidents; only anchors (`register.py`) show that somebody made all of them anew.
"""

import hashlib
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from operator import ne
from pathlib import Path
from typing import Literal

from palpate.experiment import clock, storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.clock import minutes
from palpate.experiment.dataset import build, checks, register, tables
from palpate.experiment.dataset.checks import Dataset, Sessions
from palpate.experiment.dataset.outside import accidents, losses, shared
from palpate.experiment.dataset.outside.signatures import Signer, soundly_signed
from palpate.experiment.dataset.register import DIGITS, LOG, Anchor, Anchored, Evidence, anchors_of_file
from palpate.experiment.errors import DatasetError, Finding, OtherFormat, PalpateError, Remedy, Verdict
from palpate.experiment.protocol import approval
from palpate.experiment.protocol import files as protocols
from palpate.experiment.protocol.blocks import count
from palpate.experiment.records import bridging, journal
from palpate.experiment.records.entries import Header, Purpose, Resumed, Trace
from palpate.experiment.records.progress import progress
from palpate.experiment.study import approvals, enrolment
from palpate.experiment.study.approvals import Approvals
from palpate.experiment.study.roster import Roster

MISTYPED = 2
"""A number that differs from an anchor's in so many of its digits was meant to be that one."""

FOREIGN = (
    "does not match any line of this dataset: it belongs to another dataset of the same study, or every line of this "
    "dataset was rewritten; give the register that has the anchors of this dataset"
)
"""What is said of a register or a number of which no anchor holds."""

ROSTER_FIRST = "restore the roster first, then verify again"
"""What to do about a file that is compared with a roster which is refused itself."""

WORDS: Mapping[Verdict, Literal["holds", "refused", "note"]] = {
    "passes": "holds",
    "refuses": "refused",
    "unknown": "note",
    "warns": "note",
}
"""What a verdict is called in the report."""


@dataclass(frozen=True)
class Report:
    """What the dataset is, all findings, with places inside of it, and what follows from them in sentences."""

    title: str
    findings: tuple[Finding, ...]
    verdict: tuple[str, ...]

    @property
    def refused(self) -> int:
        """How many findings speak against the dataset."""
        return sum(finding.refuses for finding in self.findings)

    def records(self) -> list[dict[str, str]]:
        """Return of each finding whether it holds, the item, and the text: a path inside the dataset, or a thing."""
        return [{"word": WORDS[one.verdict], "item": str(one.where), "text": one.clause()} for one in self.findings]


def verify(
    root: Path, registers: Sequence[Path] = (), numbers: Sequence[str] = (), signer: Signer | None = None
) -> Report:
    """Return every finding about a dataset.

    `registers` are files of anchors, `numbers` those in a lab book, or whole lines of it; with a `signer` only anchors
    that one of its keys signed count. Raises `DatasetError` if the folder is not a dataset, and for typing mistakes: an
    unreadable register, number or key, a number that differs from an anchor's in at most `MISTYPED` digits, or another
    key than the signer's.
    """
    if not root.is_dir():
        raise DatasetError(root, "is not a folder", "give the folder of a dataset, which contains sourcedata")
    if signer is not None and not registers:
        raise DatasetError(
            "got --signer without --register", remedy="give the register too", allowed="both, or --register alone"
        )
    if signer is not None:
        signer.keys()
    for path in registers:
        _check_place(root, path)
    try:
        storage.refuse_other_format(root)
    except OtherFormat as other:
        verdict = "NOT CHECKED: this version of palpate does not read this dataset format. It found no damage."
        return Report(f"a dataset in another format: {root}", (_inside(root, other.finding),), (verdict,))
    journals = checks.journals(root)
    roster = storage.roster_path(root)
    sessions: list[tuple[Path, Header]] = []
    rosters: list[Roster] = []
    enrolled = [_file_finding(root, roster, lambda: _roster(roster, rosters))] if roster.exists() else []
    people = rosters[0] if rosters else Roster(roster)
    here = [path for path in journals if not people.has_erased(str(path))]
    findings = [_file_finding(root, path, lambda path=path: _session(root, path, sessions)) for path in here]  # type: ignore[misc]
    findings += enrolled
    known = {(header.study, header.purpose) for _, header in sessions}
    evidence, told = _evidence(root, known, registers, numbers, signer)
    files = {path.relative_to(root).as_posix(): register.line_hashes(path) for path in (roster, *journals)}
    foreign = [place for place in evidence if _is_foreign(place, files)]
    ours = [place for place in evidence if place not in foreign]
    readable = people if rosters or storage.plan_path(root).exists() else None
    unlike = [_inside(root, one) for one in register.contradictions(root, readable, files, ours)]
    older = any(one.where == roster.relative_to(root).as_posix() for one in unlike)
    unlike += _other_seal(root, ours, several=older or bool(people.approved))
    refused = {str(finding.where) for finding in (*findings, *unlike) if finding.refuses}
    unlike += [Finding(FOREIGN, place.place) for place in foreign]
    whole = Sessions(root, sessions=tuple(sessions))
    findings += [_inside(root, one) for one in checks.findings(whole, "recordings", "companions")]
    already = {(one.where, one.clause()) for one in findings}
    findings += _together(root, already, evidence, refused) if checks.has_journals(root) else _tables_alone(root)
    findings = list(_cut_short(findings, _unfinished(root, people)))
    findings += _leftovers(root, people if rosters else None)
    if (root / "derivatives").exists():
        again = Remedy("produce these results again before you rely on them", ("palpate", "analyse", str(root)))
        findings.append(Finding("was not compared", "derivatives", remedy=again, verdict="unknown"))
    findings += [*_erased(root, people), *told, *unlike]
    there = {name for name, lines in files.items() if lines}.union(str(one.where) for one in unlike)
    findings += _without_session(people, there)
    findings = list(_after_the_roster(root, accidents.with_accidents(root, findings), unlike))
    kinds = " and ".join(sorted(f"{purpose} of {study}" for study, purpose in known)) or "no session"
    kinds = "a shared copy" if storage.shared_path(root).exists() else kinds
    return Report(f"{kinds}: {root}", tuple(findings), tuple(_verdict(findings, files, evidence)))


def _together(
    root: Path, told: set[tuple[Path | str, str]], evidence: Sequence[Evidence], refused: set[str]
) -> Iterator[Finding]:
    """Tell what several files show together, but for what is `told` already; those that are `refused` show nothing."""
    held: Dataset | None = None
    unmade = stopped = False
    doubts: list[Finding] = []
    differing: list[Finding] = []
    try:
        dataset = checks.load(root)
        doubts = [_inside(root, one) for one in checks.findings(dataset) if one.check != "anchors"]
        refused = refused | {str(one.where) for one in doubts if one.refuses}
        sound = tuple(one for one in dataset.sessions if one[0].relative_to(root).as_posix() not in refused)
        under_way = dataset.under_way.intersection(path for path, _ in sound)
        held = replace(dataset, sessions=sound, under_way=under_way, whole=not refused)
        if sound:
            differing = [_inside(root, one) for one in checks.findings(held, *checks.OF_TABLES)]
            unmade = bool(differing) and tables.unmade(root, dataset)
    except PalpateError as error:
        doubts, stopped = [*doubts, _inside(root, error.finding)], True
    for finding in (*doubts, *(() if unmade else differing)):
        if (finding.where, finding.clause()) not in told:
            told.add((finding.where, finding.clause()))
            yield finding
    if held is None or not held.sessions:
        none = (
            "every journal was refused, or what they are compared with was"
            if refused or any(one.refuses for one in doubts)
            else "there are no journals"
        )
        yield Finding(f"{none}: headers, seed and tables were not compared", "sessions", verdict="unknown")
        return
    of = "protocol and the plan" if held.roster is None else "sealed protocol, seed and roster"
    text = f"each {'sound ' if refused else ''}journal matches its path, the {of}"
    yield Finding(text, "headers", verdict="passes")
    if held.roster and enrolment.seed_is_proven(root):
        by_roster = held.roster.path.relative_to(root).as_posix() in refused
        text = "its hash is in the roster, but the roster was refused, so the date on which it was drawn is unproven"
        if not by_roster:
            text = "was drawn before the first participant enrolled, as its hash in the roster shows"
        yield Finding(text, "seed", verdict="unknown" if by_roster else "passes")
    yield from _sealed(held, evidence) if held.roster else ()
    if held.roster and not (root / LOG).exists():
        ended = len(held.sessions) - len(held.under_way)
        why = f"{count(ended, 'session')} ended, so it was deleted, or palpate was killed before the first anchor"
        text = f"is missing: {why if ended else 'no session has ended yet'}; the end of each session adds an anchor"
        yield Finding(text, LOG.as_posix(), verdict="unknown")
    for path in sorted(held.under_way):
        yield Finding(checks.OPEN, path.relative_to(root).as_posix(), verdict="unknown")
    if unmade:
        yield Finding(f"were not compared: {tables.UNMADE}", "tables", verdict="unknown")
        return
    if stopped:
        yield Finding("were not compared: the comparison stopped at a refused file", "tables", verdict="unknown")
        return
    others = "except those refused, " if differing else ""
    given = " that were not refused; other tables and" if refused else ";"
    text = f"{others}match the journals{given} recorded traces of movement were not compared"
    yield Finding(text, "tables", verdict="passes")


def _sealed(held: Dataset, evidence: Sequence[Evidence]) -> Iterator[Finding]:
    """Yield the seal of each approval; only an anchor shows that it was not edited."""
    anchored = {one.seal_sha256 for place in evidence for one in place.anchors}
    if (known := held.approvals) is None:
        return
    for one in known.approved:
        if one.seal_sha256 is None:
            continue
        file = storage.protocol_path(held.root, one.number)
        seal = approval.read(file)
        verdict: Verdict = "unknown" if anchored.isdisjoint(approvals.seal_forms(file)) else "passes"
        which = "" if one.number == 1 else f" {one.number}"
        yield Finding("matches the protocol", f"seal{which}", verdict="passes")
        yield Finding(f"from {seal.approved_on} to {seal.expires_on}", f"approval{which}", verdict=verdict)
        yield Finding(seal.approval_number, f"approval{which} number", verdict=verdict)
        yield Finding(" ".join(seal.board.split()), f"board{which}", verdict=verdict)
    yield from _without_approval(held, known)


def _without_approval(held: Dataset, known: Approvals) -> Iterator[Finding]:
    """Yield each session on a day without approval, by all lines of the roster, or in a journal that names no seal.

    A session that went on another day did so under any approval of its version.
    """
    for path, header in held.sessions:
        on, where = date.fromisoformat(header.started_utc[:10]), path.relative_to(held.root).as_posix()
        one = known.approved[known.number_of(header.seal_sha256) - 1]
        if on + A_DAY < one.approved_on or one.expires_on < on - A_DAY:
            days = f"approval {one.number} was valid from {one.approved_on} to {one.expires_on}"
            text = f"began on {on}, but {days}: either a renewal was not recorded, or the session had no approval"
            yield Finding(text, where, verdict="warns")
        stops = [known.stop(day) for day in (on - A_DAY, on, on + A_DAY)]
        later = known.stops[len(held.people.as_of(header.roster_sha256).stopped) :]
        backdated = any(one.kind != "lifted" and one.from_on < on for one in later)
        if (stop := stops[0]) is not None and all(stops) and backdated:
            text = f"began on {on}, although the study was {stop.kind} from {stop.from_on} (recorded later)"
            yield Finding(text, where, verdict="warns")
        version = [other for other in known.approved if known.version(other.number) == known.version(one.number)]
        for day in _resumed_on(path):
            text = f"was continued on {day}, when no approval of its version was valid"
            if not any(other.approved_on <= day + A_DAY and day - A_DAY <= other.expires_on for other in version):
                yield Finding(text, where, verdict="warns")
            halt = known.stop(day)
            if halt is not None and all(map(known.stop, (day - A_DAY, day + A_DAY))):
                text = f"was continued on {day}, although the study was {halt.kind} from {halt.from_on}"
                yield Finding(text, where, verdict="warns")


def _resumed_on(path: Path) -> list[date]:
    """Return the days, in UTC, on which a session went on after a pause."""
    if b'"kind":"resumed"' not in storage.read_bytes(path):
        return []
    contents = journal.read(path, strict=False)
    known = zip(contents.lines, bridging.shifted(contents), strict=True)
    times_ns = [line.t_ns + shift_ns for line, (entry, shift_ns) in known if isinstance(entry, Resumed)]
    return list(dict.fromkeys(date.fromisoformat(clock.utc(t_ns)[:10]) for t_ns in times_ns))


A_DAY = timedelta(days=1)
"""Where a session was run, its day may differ from that of UTC by this."""


def _tables_alone(root: Path) -> Iterator[Finding]:
    """Tell what stands behind tables without journals."""
    if storage.shared_path(root).exists():
        yield from (_inside(root, one) for one in shared.findings(root))
        return
    if (origin := tables.origin_of(root)) not in tables.ALONE:
        text = f"has no journals, although the tables are labeled {origin}; restore it from a backup"
        yield Finding(text, "sourcedata")
        return
    text = f"these tables have no journals, {tables.ALONE[origin]}: palpate cannot detect changes"
    yield Finding(text, origin, verdict="unknown")


def _file_finding(root: Path, path: Path, check: Callable[[], str]) -> Finding:
    """Return what a check says of a file, or the error that it raises."""
    try:
        return Finding(check(), path.relative_to(root).as_posix(), verdict="passes")
    except PalpateError as error:
        return _inside(root, error.finding)


def _inside(root: Path, finding: Finding) -> Finding:
    """Return a finding with its file by the path inside the dataset."""
    return replace(finding, where=finding.place(root))


def _session(root: Path, path: Path, sessions: list[tuple[Path, Header]]) -> str:
    contents = journal.read_if_begun(path, strict=False)
    if not contents.lines:
        return "has no lines: the session never began"
    sessions.append((path, contents.header))
    journal.refuse_unreadable(path, contents)
    for refusal in checks.findings(Sessions(root, sessions=tuple(sessions[-1:])), "rigs"):
        raise DatasetError.at(refusal)
    there = losses.without_lost(path, contents.entries)
    traced = [trace for entry in there if (trace := entry.frames)]
    for _ in build.raw_frames(path, there):
        pass
    raw, more = _unnamed(path, contents)
    of, each = traced[0].of_what if traced else Trace.of_what
    if more and progress(contents.entries).complete:
        what = f"{count(more, 'byte')} follow the last {each} recorded in the journal of this complete session"
        raise DatasetError(raw, what, "restore the file from a backup")
    torn = f"; {count(len(contents.torn), 'byte')} at the end: an incomplete line" if contents.torn else ""
    told = f"{count(len(contents.lines), 'line')} in an unbroken chain that ends at its head{torn}"
    frames = f" and the {of} of {count(len(traced), each)} match it" if traced else " matches it"
    unnamed = (
        f"; {count(more, 'byte')} of {of} follow that no line records, e.g., after an interrupted {each}"
        if more
        else ""
    )
    held = progress(contents.entries)
    paused = held.footer is not None and held.footer.reason == "paused" and not held.complete
    still = f"; its session is open: it was paused with {count(len(held.remaining), 'trial')} left" if paused else ""
    back_s = bridging.set_back_ns(contents) / 1e9
    back = f"; the clock was set back by {minutes(back_s)} during a pause; the times were corrected" if back_s else ""
    return f"{told}; its rig{frames}{unnamed}{still}{back}"


def _unnamed(path: Path, contents: journal.Contents) -> tuple[Path, int]:
    """Return the file of a journal's raw data, and how many bytes follow the last that it names; itself without one."""
    end = max((trace.offset + trace.length for entry in contents.entries if (trace := entry.frames)), default=0)
    for raw in (storage.raw_path(path, name) for name in storage.RAW):
        if raw.exists():
            return raw, max(storage.size(raw) - end, 0)
    return path, 0


def _roster(path: Path, rosters: list[Roster]) -> str:
    enrolled = Roster.load(path)
    rosters.append(enrolled)
    torn = (
        f"; an incomplete last line of {count(len(enrolled.lines.end.torn), 'byte')} does not count"
        if enrolled.lines.end.torn
        else ""
    )
    times = [link.t_ns for link in enrolled.lines.links]
    back = "; a line has an earlier time than the line before it: the clock was wrong" if times != sorted(times) else ""
    return f"{len(enrolled.consent_on)} enrolled, {len(enrolled.withdrawn)} of them withdrawn{torn}{back}"


def rig_files(dataset: Sessions) -> Iterator[Finding]:
    """Yield each rig file, with its response tables, that is not the one that the journal beside it names."""
    for path, header in dataset.sessions:
        file = storage.rig_path(path)
        if not file.exists() and not file.is_symlink():
            yield Finding("is named in its journal but is missing", file, remedy="restore it from a backup")
            continue
        try:
            rig = rigs.session_rig(file, header.rig_sha256)
            for table in rig.response_tables:
                rigs.response_table(file.parent, table)
        except PalpateError as error:
            yield error.finding


def recordings(dataset: Sessions) -> Iterator[Finding]:
    """Yield each recording that is not the one that journals name, or that all are, where any is named."""
    folder, backup = dataset.root / storage.RECORDINGS, "restore it from a backup"
    manifest = folder / "manifest.toml"
    if not (named := {header.recordings_sha256 for _, header in dataset.sessions} - {None}):
        return
    try:
        data = storage.read_bytes(manifest)
        takes = [(str(take["file"]), str(take["sha256"])) for take in tomllib.loads(data.decode())["takes"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        yield Finding(f"cannot be read ({storage.why(error)})", manifest, remedy=backup)
        return
    if named != {hashlib.sha256(data).hexdigest()}:
        yield Finding("does not match the journals", manifest, remedy=backup)
        return
    broken = [name for name, sha256 in takes if _sha256(folder / name) != sha256]
    yield from (Finding("is missing or does not match the manifest", folder / name, remedy=backup) for name in broken)
    if not broken:
        are = "take matches" if len(takes) == 1 else "takes match"
        text = f"{len(takes)} {are} the manifest, and the manifest matches the journals"
        yield Finding(text, folder, verdict="passes")


def companions(dataset: Sessions) -> Iterator[Finding]:
    """Yield each file beside a protocol of the dataset, whether it is the one that the protocol names.

    Copies for others may be without them: `shared` compares what was given out.
    """
    given_out = storage.shared_path(dataset.root).exists()
    for path in storage.protocol_paths(dataset.root):
        try:
            protocol = protocols.load(path)
        except PalpateError:
            # A protocol that cannot be read is reported where it is compared.
            continue
        for name in protocol.companions:
            if given_out and not path.with_name(name).exists():
                continue
            try:
                protocols.companion(protocol, name)
                yield Finding(f"matches {path.name}", path.with_name(name), verdict="passes")
            except PalpateError as error:
                yield error.finding


def _sha256(path: Path) -> str | None:
    try:
        return hashlib.sha256(storage.read_bytes(path)).hexdigest()
    except OSError:
        return None


def _leftovers(root: Path, people: Roster | None) -> Iterator[Finding]:
    if people and (copy := storage.protocol_path(root, len(people.approved) + 2)).exists():
        text = "belongs to an interrupted amendment that is not on record"
        remedy = "run palpate amend again, or delete it with its seal"
        yield Finding(text, copy.relative_to(root).as_posix(), remedy=remedy, verdict="unknown")
    left = sorted(
        path.relative_to(root).as_posix() for path in root.rglob(".*") if storage.TEMPORARY.fullmatch(path.name)
    )
    if left:
        yield Finding(f"left by interrupted commands: {', '.join(left)}", "temporary files", verdict="unknown")


def _check_place(root: Path, path: Path) -> None:
    """Refuse what is no register, and one inside the dataset."""
    if path.resolve().is_relative_to(root.resolve()):
        what = "is inside the dataset, where anyone who can change the dataset can change the register"
        raise DatasetError(path, what, "give a register stored elsewhere")
    kept, _ = register.read(path)
    if not kept and not any(word in storage.read_bytes(path) for word in (b'"anchor"', b'"prefixes"')):
        raise DatasetError(path, "is not a register: it has no anchors", "give the file that palpate anchor wrote to")


def _cut_short(findings: Sequence[Finding], mends: Mapping[str, Remedy]) -> Iterator[Finding]:
    """Tell of each withdrawal that was cut short what finishes it; the table of participants is older than these."""
    for one in findings:
        if mends and (one.verdict, one.where) == ("refuses", "participants.tsv"):
            yield from (Finding("is older than the roster", one.where, remedy=mend) for mend in mends.values())
        else:
            yield one
    if not any(one.where == "participants.tsv" or [one.remedy] == [*mends.values()] for one in findings):
        yield from (Finding("", "withdrawn", remedy=mend, verdict="unknown") for mend in mends.values())


def _erased(root: Path, people: Roster) -> Iterator[Finding]:
    for participant in sorted(people.erased):
        if not people.left_of(root, participant):
            yield Finding(
                "has no data; the roster records that they were erased", f"sub-{participant}", verdict="unknown"
            )


def _without_session(people: Roster, files: set[str]) -> Iterator[Finding]:
    """Tell who is enrolled, has not withdrawn, and has none of these `files`."""
    there = {*people.withdrawn, *(Path(file).parent.name.removeprefix("sub-") for file in files)}
    if labels := [label for label in people.consent_on if label not in there]:
        who = f"{'participant' if len(labels) == 1 else 'participants'} {', '.join(labels)}"
        text = (
            f"there are no sessions with {who} here: either none has begun, or they were deleted together with the "
            "anchor log"
        )
        yield Finding(text, "roster", verdict="unknown")


def _evidence(
    root: Path,
    known: set[tuple[str, Purpose]],
    registers: Sequence[Path],
    numbers: Sequence[str],
    signer: Signer | None,
) -> tuple[list[Evidence], list[Finding]]:
    """Return the anchors that count, and what is to be said of registers and numbers; without `known` all count."""
    evidence: list[Evidence] = []
    findings: list[Finding] = []
    all_anchors: list[Anchor] = []
    for path in (*([root / LOG] if (root / LOG).exists() else []), *registers):
        inside = path == root / LOG
        kept, broken = register.read(path)
        if inside and known and (others := register.foreign_anchors(path, kept, *known)):
            findings.append(_inside(root, others))
        if broken:
            lines = ", ".join(map(str, broken))
            verdict: Verdict = "refuses" if inside and not kept else "unknown"
            text = f"cannot be read and proves nothing: line {lines}"
            findings.append(Finding(text, str(path), verdict=verdict))
        mine = [one for one in kept if not known or (one.anchor.study, one.anchor.purpose) in known]
        counted = mine if signer is None or inside else [one for one in mine if signer.signed(one)]
        by = f" signed by {signer.path}" if signer and not inside else ""
        if signer and (unsigned := len(mine) - len(counted)):
            do = "1 anchor does" if unsigned == 1 else f"{unsigned} anchors do"
            findings.append(Finding(f"{do} not count: {signer.path} did not sign them", str(path), verdict="unknown"))
        if signer and not counted and any(map(soundly_signed, mine)):
            raise DatasetError(
                signer.path,
                f"is not the key that signed the anchors of this dataset in {path}; give that key",
                "if this is your lab's only key, somebody else wrote the register",
            )
        if not counted and not inside:
            findings.append(Finding(f"has no anchors of this dataset{by}", str(path)))
        anchors = tuple(one.anchor for one in counted)
        all_anchors += anchors
        guard = f"write to {path}" + (f", with the private key of {signer.path}" if signer else "")
        evidence.append(Evidence(str(path), anchors, "" if inside else guard))
    for number in numbers:
        line = re.search(r"\s((?:[0-9a-f]{4}-){3}[0-9a-f]{4})\s*$", number, re.IGNORECASE)
        digits = re.sub(r"[\s-]", "", line[1] if line else number).lower()
        if not re.fullmatch(rf"[0-9a-f]{{{DIGITS}}}", digits):
            raise DatasetError(
                "--number", f"got {number!r}", "correct it", allowed=f"{DIGITS} digits and letters a to f"
            )
        found = tuple(anchor for anchor in all_anchors if anchor.number == digits)[:1]
        near = [anchor for anchor in all_anchors if sum(map(ne, digits, anchor.number)) <= MISTYPED]
        if near and not found:
            what = f"got {number!r}, which is close to the number of the anchor {near[0].line}"
            raise DatasetError("--number", what, "check it against the lab book")
        if not found:
            why = "the number was mistyped or belongs to another dataset, or that file was changed"
            text = f"{LOG} has no anchor with this number: {why}"
            findings.append(Finding(text, f"number {number}"))
        evidence.append(Evidence(f"number {number}", found, "change the lab book"))
    return evidence, findings


def _is_foreign(place: Evidence, files: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a place outside agrees with no line of a dataset: it is of another, or all was made anew."""
    told = [(files.get(prefix.file, ()), prefix) for anchor in place.anchors for prefix in anchor.prefixes]
    same = any(prefix.begins(hashes) for hashes, prefix in told)
    # A file that has fewer lines than were anchored is an older state.
    other = any(len(hashes) >= prefix.lines for hashes, prefix in told)
    return bool(place.guard) and other and not same


def _after_the_roster(root: Path, findings: Sequence[Finding], unlike: Sequence[Finding]) -> Iterator[Finding]:
    """Yield findings; those that compare with a roster that is refused itself have it restored first."""
    roster = storage.roster_path(root).relative_to(root).as_posix()
    refused = [one for one in findings if one.refuses and one.where == roster]
    by_accident = any(one.check == accidents.CHECK for one in refused)
    for one in findings:
        if refused and one.refuses and one.check in ("journals", "facts") and one.where != roster:
            yield replace(one, remedy=ROSTER_FIRST)
        elif by_accident and one in unlike and not (root / one.where).exists():
            yield replace(one, verdict="unknown")
        else:
            yield one


def _other_seal(root: Path, evidence: Sequence[Evidence], *, several: bool) -> Iterator[Finding]:
    """Tell a seal that is not the one that was anchored, by the first anchor that has another.

    With `several` approvals, or if some may be lost, it is not known which one's it was.
    """
    path, kept = approval.seal_path(storage.protocol_path(root)), checks.seals(root)
    for place in evidence:
        for anchor in place.anchors:
            if anchor.seal_sha256 not in (None, *kept):
                day = anchor.anchored_utc[:10]
                by = f"the anchor of {day} in {place.place}"
                if several and kept:
                    text = f"a seal is missing, or differs from {by}; restore all seals from a backup"
                    yield Finding(text, "seals")
                else:
                    unlike = "differs from" if kept else "is missing, but was in"
                    text = f"{unlike} {by}; restore it from a backup"
                    yield Finding(text, path.relative_to(root).as_posix())
                return


def _unfinished(root: Path, roster: Roster) -> dict[str, Remedy]:
    """Return what finishes each interrupted withdrawal, by participant: in journals, files or the table."""
    table = root / "participants.tsv"
    marked = {row.get("participant_id"): row.get("withdrawn") for row in checks.table_rows(table)}
    return {
        participant: checks.finish_withdrawal(root, roster, participant)
        for participant in roster.withdrawn
        if marked.get(f"sub-{participant}", "1") != "1"
        or not _is_marked(root, participant)
        or (participant in roster.erased and (f"sub-{participant}" in marked or roster.left_of(root, participant)))
    }


def _is_marked(root: Path, participant: str) -> bool:
    """Return whether a participant's withdrawal stands outside of the roster: in all their journals, or by itself."""
    own = [path for path in storage.journals(root) if path.parent == storage.participant_folder(root, participant)]
    begun = [content for content in map(storage.read_bytes, own) if b"\n" in content]
    marked = begun and all(b'"kind":"withdrawal"' in content for content in begun)
    return bool(marked) or storage.withdrawal_path(root, participant).exists()


def _most_anchored(files: Mapping[str, Sequence[str]], evidence: Sequence[Evidence]) -> list[Anchored]:
    """Return of each file the most lines that are as they were anchored, where there are any."""
    same = ([one for one in anchors_of_file(*file, evidence) if one.same] for file in files.items())
    return [anchored[-1] for anchored in same if anchored]


def _has_remedy(finding: Finding) -> bool:
    """Return whether what a finding says puts things right: of an accident, or by a command."""
    return finding.check == accidents.CHECK or (isinstance(finding.remedy, Remedy) and finding.remedy.suffices)


def _verdict(
    findings: Sequence[Finding], files: Mapping[str, Sequence[str]], evidence: Sequence[Evidence]
) -> Iterator[str]:
    if refused := [finding for finding in findings if finding.refuses]:
        speak = "1 finding speaks" if len(refused) == 1 else f"{len(refused)} findings speak"
        mend = (
            "Follow the remedies above"
            if all(map(_has_remedy, refused))
            else "Change nothing in the folder, and compare it with a backup"
        )
        yield f"REFUSED: {speak} against this dataset. {mend}."
        return
    if any(finding.check == shared.CHECK for finding in findings):
        yield "No problems found in this copy: an accidental change to any of its files would have been detected."
        yield (
            "NOT PROVEN: the journals were not shared (the lab has them); their anchor is in dataset_description.json."
        )
        return
    if not (total := sum(map(len, files.values()))):
        yield "NOT PROVEN: these tables have no journals, so palpate cannot detect accidental or deliberate changes."
        return
    yield "No problems found in this dataset: an accidental change to anything listed above would have been detected."
    outside = [place for place in evidence if place.guard]
    for place in outside:
        if not (best := _most_anchored(files, [place])):
            continue
        anchored, days = sum(one.lines for one in best), sorted(one.day for one in best)
        when = f"on {days[0]}" if days[0] == days[-1] else f"when they were anchored, from {days[0]} to {days[-1]}"
        are = "is as it was" if anchored == 1 else "are as they were"
        yield (
            f"PROVEN by {place.place}: {anchored} of {count(total, 'line')} {are} {when}. To change any of them "
            f"without being detected, a person would also have had to {place.guard}."
        )
    if left := total - sum(one.lines for one in _most_anchored(files, outside)):
        which = f"{count(left, 'line')} that came after the last anchor" if outside else "journals, heads and tables"
        yield (
            f"NOT PROVEN: anyone who can write to this folder could have forged {which}; nothing outside the folder "
            "excludes that."
        )
