"""Whose signatures of anchors count, for whoever verifies a dataset; `register` signs."""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset.register import Kept, ssh_keygen
from palpate.experiment.errors import DatasetError


@dataclass(frozen=True)
class Signer:
    """Whose signatures count: a file of public SSH keys, one a line."""

    path: Path

    def keys(self) -> list[str]:
        """Return its keys. Raises `DatasetError` if they cannot be read."""
        try:
            keys = [line for line in storage.read_text(self.path).splitlines() if line.strip()]
        except (OSError, UnicodeDecodeError) as error:
            raise DatasetError(
                self.path, f"cannot be read ({storage.why(error)})", "give a public key (.pub)"
            ) from error
        if not keys or not all(re.match(r"(ssh|ecdsa|sk)-\S+ \S", line) for line in keys):
            raise DatasetError(self.path, "has no public SSH keys", "give the .pub file", allowed="one key per line")
        return keys

    def signed(self, kept: Kept) -> bool:
        """Return whether one of the keys signed an anchor. Raises `DatasetError` if the keys cannot be read."""
        with tempfile.TemporaryDirectory() as folder:
            allowed, signature = Path(folder, "allowed"), Path(folder, "signature")
            allowed.write_text("".join(f"laboratory {line}\n" for line in self.keys()), "utf-8")
            signature.write_text(kept.signature or "", "utf-8")
            asked = ("verify", "-f", str(allowed), "-I", "laboratory", "-s", str(signature))
            return ssh_keygen(asked, kept.anchor).returncode == 0


def soundly_signed(kept: Kept) -> bool:
    """Return whether any key at all signed an anchor as it stands."""
    with tempfile.NamedTemporaryFile() as signature:
        signature.write((kept.signature or "").encode())
        signature.flush()
        return ssh_keygen(("check-novalidate", "-s", signature.name), kept.anchor).returncode == 0
