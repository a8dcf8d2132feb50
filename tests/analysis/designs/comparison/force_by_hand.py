"""The error of the force in a trace, `force_by_hand.py TABLE.tsv.gz`, against the block's law; no line of palpate."""

import json
import sys
from pathlib import Path

import numpy as np

table = sys.argv[1]
sidecar = json.loads(Path(table.replace(".tsv.gz", ".json")).read_text("utf-8"))
block, rate = sidecar["Force"], sidecar["SamplingFrequency"]
k, c, limit = (block[of] for of in ("StiffnessNewtonPerMetre", "DampingNewtonSecondPerMetre", "LimitNewton"))
columns = [sidecar["Columns"].index(of) for of in ("hand_height", "force_asked", "force_sent")]
read, asked, sent = np.genfromtxt(table, delimiter="\t", missing_values="n/a", usecols=columns).T
runs = np.flatnonzero(np.diff(np.isfinite(sent), prepend=False, append=False)).reshape(-1, 2)
off, whole_off, within2, whole2 = np.zeros(3), 0.0, 0.0, 0.0
at = (np.arange(8) + 0.5) / 8  # of a cycle
for begins, ends in runs:
    if ends - begins < 17:
        continue
    cycle, r = np.arange(ends - begins), -1e-3 * read[begins:ends]  # m into the block
    r = np.interp(cycle, cycle[np.isfinite(r)], r[np.isfinite(r)])
    place, speed = np.empty(r.size), np.empty(r.size)
    for n in cycle:
        first = min(max(n - 8, 0), r.size - 17)
        parabola = np.polyfit(cycle[first : first + 17] - n, r[first : first + 17], 2)
        place[n], speed[n] = parabola[2], parabola[1] * rate
    law = np.where(place > 0, np.maximum(k * place + c * speed, 0), 0)
    between = place[:-1, None] + np.diff(place)[:, None] * at, speed[:-1, None] + np.diff(speed)[:, None] * at
    whole = np.where(between[0] > 0, np.maximum(k * between[0] + c * between[1], 0), 0)
    within = np.minimum(whole, limit)
    held = [np.minimum(law, limit), np.clip(asked[begins:ends], -limit, limit), sent[begins:ends]]
    off += [((force[:-1, None] - within) ** 2).sum() for force in held]
    whole_off += ((sent[begins : ends - 1, None] - whole) ** 2).sum()
    within2, whole2 = within2 + (within**2).sum(), whole2 + (whole**2).sum()
print(*np.sqrt(off / within2), np.sqrt(whole_off / whole2))
