"""What was played, in `numerics/played.npz`, against equations (1), (3) to (5) as printed; no line of palpate."""

import numpy as np

file = np.load("numerics/played.npz")
hz, v_i = np.arange(2500.0), file["recorded_mm_s"]
basis = np.cos(np.pi / 2500 * np.outer(hz, np.arange(2500) + 0.5))
low, high = hz / 35, hz / 360
gain = (
    4 * low**2 / np.hypot(1 - low**2, low) / np.hypot(1 - high**2, 0.24 * high)
)  # m/s^2 for each volt of a small drive
for m, material in enumerate(file["materials"]):
    for n, v in enumerate(file["speeds_mm_s"]):
        i = min(max(np.searchsorted(v_i, v, side="right") - 1, 0), 2)
        line = file["amplitudes"][m, i] + np.diff(file["amplitudes"][m], axis=0)[i] * (v - v_i[i]) / (
            v_i[i + 1] - v_i[i]
        )
        asked = np.maximum(line, 0) * file["signs"][m, i if v - v_i[i] <= v_i[i + 1] - v else i + 1]
        for u, unit in enumerate(file["units"]):
            c = basis @ file["handed"][u, m, n] * 2 / 2500
            moved = c if unit == "m/s^2" else gain * 5 * np.arcsinh(c / 5)
            truth = np.linalg.norm((moved - asked)[1:]) / np.linalg.norm(asked[1:])
            print(material, round(v), unit, truth, file["truth"][u, m, n], file["total"][u, m, n])
