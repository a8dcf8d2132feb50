"""What was heard beside what was sent, from a dataset's tables; no line of palpate. Run it in the dataset's folder."""

import csv
import statistics
from collections import defaultdict
from math import log10
from pathlib import Path

off: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
for path in sorted(Path().glob("sub-*/beh/*_events.tsv")):
    task = path.name.partition("_task-")[2].removesuffix("_events.tsv")
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE):
            if row.get("heard_peak", "n/a") == "n/a":
                continue
            sent, heard = ([float(db) for db in row[name].split(" | ")] for name in ("sent_thirds", "heard_thirds"))
            least_db = 10 * log10(sum(10 ** (db / 10) for db in sent)) - 30
            third = max(abs(h - s) for s, h in zip(sent, heard, strict=True) if s >= least_db)
            peak = 20 * log10(float(row["heard_peak"]) / float(row["sent_peak"]))
            delay = float(row["heard_delay"].replace("n/a", "nan")) * 1e3
            off[task, row["presented"]].append((peak, third, delay))
for (task, presented), stimuli in sorted(off.items()):
    peaks, thirds, delays = zip(*stimuli, strict=True)
    worst = max(peaks, key=abs), max(thirds), max(delays)
    for name, each, most in zip(("peak", "third", "delay"), (peaks, thirds, delays), worst, strict=True):
        print(task, presented, name, statistics.median(each), most, sep="\t")
