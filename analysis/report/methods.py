"""Every formula of the analysis by its name, as the report states them."""

from __future__ import annotations

from analysis.identification.identify import CHOICE_RESAMPLES, INFORMATION_RESAMPLES
from analysis.identification.results import SEED
from analysis.identification.time_course import BIN_WIDTHS_MM_S, MOST_BINS, WINDOW
from analysis.statistics.inference import RESAMPLES

METHODS: tuple[tuple[str, str], ...] = (
    (
        "Answer ratio",
        "r = count of an answer / trials in which the material was presented, for one participant; trials without an "
        "answer count among the trials.",
    ),
    (
        "Mean and standard deviation",
        "mean = Σ r / n; SD = √( Σ (r - mean)² / (n - 1) ), over the n participants to whom the material was "
        "presented.",
    ),
    ("t against chance", "t = (mean - chance) / (SD / √n), n - 1 degrees of freedom, P two-tailed (Student)."),
    ("Cohen's d", "d = (mean - chance) / SD."),
    ("Stars", "*, **, ***: mean above chance and P < 0.05, 0.01, 0.001, P not adjusted."),
    (
        "Holm's correction",
        "The i-th smallest of m values of P is multiplied by m - i + 1; no result is below that of a smaller P. The "
        "family is the materials of one task.",
    ),
    (
        "Interval of d",
        "The noncentralities at which the observed t stands at the tails of noncentral t, over √n (Steiger and "
        "Fouladi 1997).",
    ),
    (
        "Bayes factor",
        "JZS: Cauchy prior of scale √2 / 2 on the effect size (Rouder et al. 2009, equation (1)); BF10 above 1 speaks"
        " for a mean that differs from chance.",
    ),
    (
        "Intervals of a ratio",
        "Wilson's score interval without continuity correction; Clopper and Pearson's from beta quantiles; BCa "
        "bootstrap (Efron 1987) over participants, acceleration by leaving out one participant.",
    ),
    (
        "Information",
        "I = H(presented) + H(answered) - H(both), bits. Miller-Madow: less ( Σ (R_s - 1) - (R - 1) ) / (2 N ln 2), "
        "R_s answers that occurred to material s, R answers that occurred. Panzeri-Treves (1996): the same with R_s "
        "estimated by Bayes's rule.",
    ),
    ("d'", "p = ∫ φ(z - d') Φ(z)^(m - 1) dz, solved for d' (Green and Swets 1966; Hacker and Ratcliff 1979)."),
    (
        "Similarity-choice model",
        "p(j | i) = s_ij b_j / Σ s_ik b_k, s_ij = s_ji, s_ii = 1 (Luce 1963), maximum likelihood by iterative "
        "proportional fitting; G² = 2 Σ n ln(n / fitted) on (M - 1)(M - 2) / 2 degrees of freedom.",
    ),
    (
        "Map and Mantel's test",
        "Classical scaling (Torgerson 1952) of 1 - (p_ij + p_ji) / (p_ii + p_jj). Mantel (1967): Pearson's r over the"
        " pairs, P the share of all orders of the materials with r at least as extreme.",
    ),
    (
        "One-way ANOVA",
        "F = ( Σ nᵢ (meanᵢ - mean)² / (g - 1) ) / ( Σ Σ (r - meanᵢ)² / (N - g) ). The g = 4 groups are the ratios of "
        "two materials a and b: a answered to a, b to b, a's trials answered b, b's answered a.",
    ),
    (
        "Two-way ANOVA",
        "Fixed effects, with interaction, on the correct ratios; R( ) is a reduction in the sum of squares. Type I: "
        "R(task), R(material | task). Type II: R(task | material), R(material | task). Type III: each effect given "
        "all others, with sum-to-zero contrasts. The interaction is the same in all. Sums are formed in rational "
        "numbers.",
    ),
    (
        "Partial eta squared",
        "df1 F / (df1 F + df2). Its interval of 90 % inverts noncentral F, noncentrality L as L / (L + df1 + df2 + 1)"
        " (Steiger 2004), and excludes 0 exactly when P < 0.05.",
    ),
    (
        "ICC, one-way random",
        "ICC(1,1) = ICC(1) = (MSR - MSW) / (MSR + (k - 1) MSW); ICC(1,k) = ICC(k) = (MSR - MSW) / MSR.",
    ),
    (
        "ICC, two-way, absolute agreement",
        "ICC(2,1) = ICC(A,1) = (MSR - MSE) / (MSR + (k - 1) MSE + k (MSC - MSE) / n); ICC(2,k) = ICC(A,k) = (MSR - "
        "MSE) / (MSR + (MSC - MSE) / n).",
    ),
    (
        "ICC, two-way, consistency",
        "ICC(3,1) = ICC(C,1) = (MSR - MSE) / (MSR + (k - 1) MSE); ICC(3,k) = ICC(C,k) = (MSR - MSE) / MSR.",
    ),
    (
        "ICC, names and intervals",
        "MSR, MSC, MSE, MSW: mean squares of the n targets, of the k raters (participants), of their interaction, and"
        " within targets. Names: Shrout and Fleiss (1979) = McGraw and Wong (1996). F = MSR / MSW or MSR / MSE; "
        "intervals from F, for ICC(2,.) with Satterthwaite's degrees of freedom.",
    ),
    (
        "Variance-component ICC",
        "S / (S + residual / k), S = component of task + of material + of their interaction, by Henderson's method "
        "III: reductions in the sum of squares set equal to their expectations, all factors random. Negative "
        "components count as zero.",
    ),
    (
        "Single trials",
        "logit P(right) = intercept + task + material + covariates. GEE, exchangeable within a participant, "
        "covariance of Mancl and DeRouen (2001); mixed logit with a normal intercept a participant, maximum "
        "likelihood by adaptive Gauss-Hermite quadrature (Pinheiro and Bates 1995). Wald tests. Covariates are used "
        "that half of the trials of every task and material have, all of them together.",
    ),
    (
        "Learning curve",
        f"Right answers over trials, of all participants together, in every run of {WINDOW} trial numbers; BCa "
        "interval over participants.",
    ),
    (
        "Speed curve",
        f"Right answers over trials in bins of the foot's speed, the narrowest of "
        f"{', '.join(map(str, BIN_WIDTHS_MM_S))} mm/s that needs no more than {MOST_BINS} bins; Wilson's interval.",
    ),
    ("Onset error", "Measured onset of the stimulus at the panel minus contact of the foot, in the trials analysed."),
    (
        "Timing",
        "Of every attempt of the participants analysed, also of those done again. Percentiles are of the magnitude, "
        "interpolated linearly, and given from 100 (p99) and 1,000 (p99.9) attempts on. Dead time: from a confirmed "
        "answer until the next trial is armed, the laying out of an object left out. Simulated time has no durations.",
    ),
    (
        "Random draws",
        f"Resamples draw whole participants by numpy's default_rng, seeded with [{SEED}, place of the task from 0], "
        f"and a 1 after that for the learning curve: {RESAMPLES} resamples for intervals of ratios, d' and the "
        f"learning curve, {INFORMATION_RESAMPLES} for information, {CHOICE_RESAMPLES} for similarities and biases. "
        "Nothing else is drawn: the same dataset gives the same numbers.",
    ),
    ("Correlation with the paper", "Pearson's r over the cells of one printed table."),
)
"""Name and formula, in the order in which the report needs them."""
