"""Pictures of the instructions: files beside a protocol, by hash, sealed and kept with it, for the screen alone."""

from __future__ import annotations

import hashlib
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image

from palpate.experiment import storage
from palpate.experiment.dataset.checks import Sessions
from palpate.experiment.dataset.verify import companions
from palpate.experiment.desk import prompts
from palpate.experiment.desk.link.wire import View
from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files
from palpate.experiment.study import privacy
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL


def png() -> bytes:
    made = BytesIO()
    Image.new("RGB", (3, 2), "gray").save(made, "PNG")
    return made.getvalue()


def illustrated(folder: Path, content: bytes) -> Path:
    """A protocol whose first task has a picture, beside it."""
    (folder / "foot.png").write_bytes(content)
    named = f'pictures = [{{ file = "foot.png", sha256 = "{hashlib.sha256(content).hexdigest()}" }}]'
    text = SMALL.replace("format = 4", "format = 7").replace(
        'instruction = "Step."', f'instruction = "Step."\n{named}', 1
    )
    file = folder / "small.toml"
    file.write_text(text, "utf-8")
    return file


def test_a_picture_is_kept_and_verified_with_its_protocol(tmp_path: Path, palpate: Palpate) -> None:
    file, root = illustrated(tmp_path, png()), tmp_path / "dataset"
    assert palpate("check", file)[0] == 0
    storage.people_folder(root)
    kept = storage.protocol_path(root)
    files.keep(file, kept)
    assert files.pictures(files.load(kept)) == {"foot.png": png()}
    assert privacy.unknown_files(root) == []
    assert [one.verdict for one in companions(Sessions(root))] == ["passes"]
    kept.with_name("foot.png").write_bytes(png() + b"\0")
    assert [one.verdict for one in companions(Sessions(root))] == ["refuses"]


def test_a_copy_for_others_may_be_without_a_picture(tmp_path: Path) -> None:
    kept = storage.protocol_path(tmp_path / "copy")
    storage.people_folder(tmp_path / "copy")
    files.keep(illustrated(tmp_path, png()), kept)
    kept.with_name("foot.png").unlink()
    for made, verdicts in ((False, ["refuses"]), (True, [])):
        if made:
            storage.write_json(storage.shared_path(tmp_path / "copy"), {})
        assert [one.verdict for one in companions(Sessions(tmp_path / "copy"))] == verdicts


DAMAGED = {
    "another format": b"GIF89a",
    "cut off": png()[:-5],
    "empty": b"",
    "a bit inside": png()[:45] + bytes([png()[45] ^ 1]) + png()[46:],
    "a length": png()[:8] + b"\xff" + png()[9:],
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_what_is_no_whole_picture_is_refused(tmp_path: Path, content: bytes, palpate: Palpate) -> None:
    file = illustrated(tmp_path, content)
    with pytest.raises(ProtocolError) as error:
        files.pictures(files.load(file))
    assert error.value.findings[0].field == "file"
    assert palpate("check", file)[0] == 2


def test_pictures_are_shown_where_the_instruction_is() -> None:
    view = View(state="armed", may="step", instruction="Step.", pictures=("foot.png",))
    assert prompts.prompt(view, {}).pictures == ("foot.png",)
    answering = view.model_copy(update={"state": "answering"})
    assert prompts.prompt(answering, {}).pictures == ()
    assert prompts.prompt(view.model_copy(update={"instruction": ""}), {}).pictures == ()
