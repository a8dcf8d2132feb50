"""Columns of the events tables made from journals, by kind of trial; shared with analysis."""

from __future__ import annotations

NO_ANSWER = "(none)"
"""How a trial without an answer stands in tables."""

EVENT_COLUMNS: dict[str, dict[str, object]] = {
    "onset": {
        "Description": "Contact of the foot with the panel, from the first frame of the session's tracker; where a "
        "step broke off, when it did. n/a where no clock ran.",
        "Units": "s",
    },
    "duration": {"Description": "Length of the stimulus. n/a where none was played by the rig.", "Units": "s"},
    "trial": {"Description": "Place of the trial in the realised order, from 1."},
    "attempt": {"Description": "1 for the first attempt at this trial, 2 after one redo, and so on."},
    "counted": {
        "Description": "Whether this attempt is the one that counts.",
        "Levels": {"1": "the attempt that counts", "0": "done again: see redo_reason"},
    },
    "presented": {"Description": "Material presented."},
    "answered": {"Description": f"Material the participant named; {NO_ANSWER} where none was named."},
    "response_time": {"Description": "From contact to the choice of the answer. n/a where no clock ran.", "Units": "s"},
    "foot_speed": {"Description": "10 mm divided by the time from 20 mm to 10 mm above the panel.", "Units": "mm/s"},
    "frames_lost": {"Description": "Tracker frames lost or damaged between arming and contact."},
    "floored_bins": {"Description": "Bins of the synthesised spectrum floored at zero. n/a without synthesis."},
    "delivered": {
        "Description": "Whether the loopback heard the stimulus as it was intended. n/a where nothing measured it.",
        "Levels": {"1": "within the rig's thresholds", "0": "early, late, changed or not at all"},
    },
    "onset_error": {
        "Description": "Measured onset of the stimulus at the panel minus contact. n/a where nothing measured it.",
        "Units": "s",
    },
    "redo_reason": {"Description": "Why this attempt was done again. n/a where it counts."},
    "origin": {
        "Description": "What produced this row.",
        "Levels": {
            "PARTICIPANT": "a participant in the room",
            "PILOT": "a participant in the room, in a pilot of the study",
            "PRACTICE": "simulated participants, simulated materials, an experimenter who practises at the keys",
            "REHEARSAL": "simulated participants, simulated materials",
            "RECONSTRUCTION": "consistent with printed tables, no original data",
        },
    },
}
"""Columns of `_events.tsv` in their order, as the sidecar describes them."""

IMPORTED_COLUMNS: dict[str, dict[str, object]] = {
    "response_time": {"Description": "As the source measured it. n/a where it says nothing."},
    "trial": {"Description": "Place of the trial in the order that the description of the task tells, from 1."},
    "origin": {"Description": "What produced this row.", "Levels": {"IMPORTED": "a participant, measured elsewhere"}},
}
"""What is said otherwise of columns of answers that were measured elsewhere."""


COMPARISON_COLUMNS: dict[str, dict[str, object]] = {
    "onset": {
        "Description": "Both samples lay before the participant, from the beginning of the session.",
        "Units": "s",
    },
    "duration": {"Description": "n/a: the participant tried both samples at will until the answer.", "Units": "s"},
    "trial": EVENT_COLUMNS["trial"],
    "attempt": EVENT_COLUMNS["attempt"],
    "counted": EVENT_COLUMNS["counted"],
    "first": {"Description": "Material presented first."},
    "second": {"Description": "Material presented second; it may be the same."},
    "answered": {"Description": f"Which of the two the participant named; {NO_ANSWER} where none was named."},
    "response_time": {
        "Description": "From both samples laid out to the choice of the answer. n/a where no clock ran.",
        "Units": "s",
    },
    "redo_reason": EVENT_COLUMNS["redo_reason"],
    "origin": EVENT_COLUMNS["origin"],
}
"""The same of a comparison of two materials."""

FURTHER_COLUMNS: dict[str, dict[str, object]] = {
    "corrected_from": {
        "Description": "Answer that was confirmed first, where the experimenter corrected it. n/a where it stands."
    },
    "response_end": {
        "Description": "What ends response_time in a session with a microphone, where the voice may take the place of "
        "the choice.",
        "Levels": {
            "voice": "where the voice began, for what was heard is the answer that the experimenter confirmed",
            "choice": "where the experimenter chose the key",
        },
    },
    "voice_onset": {
        "Description": "From contact to where the voice began. n/a where nobody was heard, or no microphone listened.",
        "Units": "s",
    },
    "choice_time": {"Description": "From contact to the choice of the key that was confirmed.", "Units": "s"},
    "confirmation_time": {"Description": "From contact to the confirmation of that choice.", "Units": "s"},
    "voice_proposed": {
        "Description": "Answer that the microphone proposed to the experimenter, who decided. n/a where it was none of "
        "those that the participant had said before."
    },
    "voice_agreement": {
        "Description": "How near what was heard is to that answer as the participant said it before: 1 as near as "
        "another take of it, 0 as far as another answer."
    },
    "voice_lead": {"Description": "How much farther the next answer was, in the same unit."},
    "masker_level": {"Description": "Level of the masker in this attempt. n/a for silence.", "Units": "dB(A)"},
    "contact_standard_error": {
        "Description": "Standard error of the contact, by the tracker's noise and by what is not known of how the foot "
        "moved. n/a where the foot did not land.",
        "Units": "s",
    },
    "prediction_error": {
        "Description": "Contact as predicted last before the onset could no longer be moved, minus actual contact. n/a "
        "where it was not predicted in time.",
        "Units": "s",
    },
    "delivery_error": {
        "Description": "Measured onset of the stimulus at the panel minus the onset that was asked for. n/a where "
        "nothing measured it.",
        "Units": "s",
    },
    "gate_to_scheduled": {
        "Description": "From the arrival of the tracker's frame that gave the gate until the onset was first "
        "scheduled. n/a where it was not.",
        "Units": "s",
    },
    "stimulus_method": {"Description": "How the samples that the actuator was handed were made."},
    "stimulus_error": {
        "Description": "How far what the actuator was handed is from what equations (1) to (5) of Okamoto et al. ask "
        "for: rms of the difference, divided by the rms asked for. Where the actuator takes volts, the rig's measured "
        "response says what they do."
    },
    "left_out": {
        "Description": "Rms of what the rig did not carry, frequencies that got nothing and what others were held back "
        "by, divided by the rms asked for; a part of stimulus_error."
    },
    "dissimilarity": {
        "Description": "Dissimilarity of what the actuator was handed to what was asked for, equation (6) of Okamoto "
        "et al.: the sum over bins from 0 to 500 Hz of the difference of amplitudes.",
        "Units": "m/s^2",
    },
    "dead_time": {
        "Description": "From the confirmed answer to the trial before until this attempt was armed, without the time "
        "in which an object was laid out. n/a where no answer came just before.",
        "Units": "s",
    },
}
"""Further columns, each left out where a session knows nothing of it, as simulated time of durations."""
