"""An error of palpate as the finding of a check: its parts, under the name of the check."""

from pathlib import Path

from palpate.experiment.apparatus.doctor.checks import refused
from palpate.experiment.errors import Finding, RigError, mismatch


def test_a_check_takes_over_the_parts_of_an_error() -> None:
    error = RigError("audio.latency", "got 40 days", "run it; or not", allowed="0 to 30 days; no more")
    assert refused("part", error) == Finding(
        "got 40 days", "audio.latency", allowed="0 to 30 days; no more", remedy="run it; or not", check="part"
    )


def test_what_cannot_be_put_right_has_no_remedy() -> None:
    assert refused("part", RigError("nothing to be done")) == Finding("nothing to be done", check="part")


def test_of_a_file_with_errors_the_file_is_to_be_corrected() -> None:
    file = Path("rig.toml")
    found = refused("part", RigError.in_file(file, [mismatch("audio.block", 3, "0", "1 or more")]))
    assert (found.where, found.remedy, found.verdict) == (file, "correct that file", "refuses")
    assert "audio.block" in found.what
