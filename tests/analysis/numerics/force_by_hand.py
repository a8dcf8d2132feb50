"""What hands felt, in `numerics/force.npz`, by equations of motion and a filter written here; no line of palpate."""

import numpy as np
from scipy.linalg import expm, solve_discrete_are

file = dict(np.load("numerics/force.npz"))
k, c, rate, fine, told = (file[of] for of in ("stiffness_n_m", "damping_n_s_m", "rate_hz", "fine", "told_kg"))
hk, hc, t = file["hand_stiffness_n_m"], file["hand_damping_n_s_m"], 1 / rate
ahead = np.array([[1, t, t * t / 2], [0, 1, t], [0, 0, 1]])
noise = file["noise_m"] ** 2 + file["count_m"] ** 2 / 12
changed = file["changes_m_s2"] * np.array([[t * t / 2], [t], [1]])
spread = solve_discrete_are(ahead.T, np.eye(3)[:, :1], changed @ changed.T, [[noise]])
gains = spread[:, 0] / (spread[0, 0] + noise)


def law(m: np.ndarray, m_s: np.ndarray, most: float) -> np.ndarray:
    return np.where(m > 0, np.clip(k * m + c * m_s, 0, most), 0)


for d, name in enumerate(file["name"]):
    mass, b = file["tip_kg"][d] + file["hand_mass_kg"], file["tip_n_s_m"][d]
    moves = expm(np.array([[0, 1, 0], [-hk / mass, -(hc + b) / mass, 1 / mass], [0, 0, 0]]) / (rate * fine))[:2]
    for v, speed in enumerate(file["speeds_m_s"]):
        read, sent, pushed, begun = (file[f"{d}_{v}_{of}"] for of in ("read_m", "sent_n", "pushed_n", "begun_s"))
        rests_m, rests_n = (0, 0) if speed else (file["inside_m"], k * file["inside_m"])
        at = np.array([speed * begun + rests_m, 0 * begun + speed])
        path = np.empty((2, *pushed.shape))
        for n in range(pushed.shape[1]):
            s = begun + (n + 0.5) / (rate * fine)
            goes_in = hk * speed * s + (hc + b) * speed
            back = hk * speed * (2 * file["in_s"] - s) - (hc - b) * speed
            pull = np.where(s <= file["in_s"], goes_in, back) if speed else (hk + k) * file["inside_m"]
            at = moves @ np.array([*at, pull - pushed[:, n]])
            path[:, :, n] = at
        off = []
        for most in (file["limit_n"], np.inf):
            wanted, got = law(path[0], path[1], most), pushed
            if not speed:
                got = pushed[:, pushed.shape[1] // 2 :: fine]
                wanted = np.full(got.shape, rests_n)
            off.append(np.sqrt(np.mean((got - wanted) ** 2) / np.mean(wanted**2)))
        # What was sent, from samples.
        seen = np.array([speed * begun + rests_m, 0 * begun + speed, 0 * begun + rests_n / told])
        worst = 0.0
        for n in range(read.shape[1]):
            if n:
                seen = ahead @ seen - np.outer([t * t / 2, t, 0], sent[:, n - 1]) / told
                seen = seen + np.outer(gains, read[:, n] - seen[0])
            worst = max(worst, np.abs(law(seen[0], seen[1], file["limit_n"]) - sent[:, n]).max())
        (told_off, told_beyond), budget = file["truth"][d, v], file["budget"][d, v, 0]
        print(name, f"{1000 * speed:g}", off[0], told_off, off[1], told_beyond, budget, worst)
