"""Anchors signed with a real SSH key by the system's `ssh-keygen`."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.dataset import register
from tests.approved import anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import make_study

if shutil.which("ssh-keygen") is None:
    pytest.skip("needs ssh-keygen", allow_module_level=True)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return make_study(tmp_path / "study").root


def make_key(path: Path) -> Path:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "lab", "-f", path], check=True)
    return path


def test_a_signed_anchor_counts_for_the_key_that_signed_it_alone(
    dataset: Path, tmp_path: Path, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    to, key, other = tmp_path / "register", make_key(tmp_path / "key"), make_key(tmp_path / "other")
    code, out, _ = palpate("anchor", dataset, "--to", to, "--sign", key)
    assert (code, f"Anchored in {to}, signed." in out) == (0, True)
    code, out, _ = palpate("verify", dataset, "--register", to, "--signer", f"{key}.pub")
    assert code == 0
    assert f"write to {to}, " in out
    assert f"private key of {key}.pub" in out
    code, out, err = palpate("verify", dataset, "--register", to, "--signer", f"{other}.pub")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert anywhere(err, tmp_path) == approved


def test_an_anchor_that_was_changed_or_never_signed_does_not_count(
    dataset: Path, tmp_path: Path, palpate: Palpate
) -> None:
    to, key = tmp_path / "register", make_key(tmp_path / "key")
    palpate("anchor", dataset, "--to", to, "--sign", key)
    kept = json.loads(to.read_text())
    kept["anchor"]["anchored_utc"] = "2001-01-01T00:00:00+00:00"
    to.write_text(json.dumps(kept) + "\n")
    palpate("anchor", dataset, "--to", to)
    code, out, _ = palpate("verify", dataset, "--register", to, "--signer", f"{key}.pub")
    assert (code, "2 anchors do not" in out, f"{key}.pub" in out) == (1, True, True)
    # Without the key they count, as the register's word.
    assert palpate("verify", dataset, "--register", to)[0] == 0


def test_another_program_checks_the_signature(dataset: Path, tmp_path: Path, palpate: Palpate) -> None:
    to, key = tmp_path / "register", make_key(tmp_path / "key")
    palpate("anchor", dataset, "--to", to, "--sign", key)
    kept = json.loads(to.read_text())
    (tmp_path / "signature").write_text(kept["signature"])
    message = json.dumps(kept["anchor"], sort_keys=True, separators=(",", ":")).encode()
    checked = subprocess.run(
        ["ssh-keygen", "-Y", "check-novalidate", "-n", register.NAMESPACE, "-s", tmp_path / "signature"],
        input=message,
        capture_output=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stderr


def test_what_is_no_key_is_refused_in_one_line(
    dataset: Path, tmp_path: Path, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    to, key = tmp_path / "register", make_key(tmp_path / "key")
    code, _, err = palpate("anchor", dataset, "--to", to, "--sign", tmp_path / "absent")
    assert (code, err.count("\n"), to.exists()) == (2, 1, False)
    assert anywhere(err, tmp_path) == approved
    palpate("anchor", dataset, "--to", to, "--sign", key)
    for signer in (key, tmp_path / "absent", to):
        code, _, err = palpate("verify", dataset, "--register", to, "--signer", signer)
        assert (code, err.count("\n")) == (2, 1), err
