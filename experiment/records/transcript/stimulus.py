"""How a stimulus was played and met the contact, in a transcript."""

from palpate.experiment.records.stimulus import Onset, Stimulus
from palpate.experiment.records.tracker import Pressed


def played_line(stimulus: Stimulus | None, onset: Onset | None) -> str:
    """Return what a transcript says of how a stimulus was played."""
    if stimulus is None:
        return "no stimulus"
    said = f"a stimulus was played, with a peak of at most {stimulus.reached_peak_m_s2:.3g} m/s^2"
    if stimulus.handed_unit == "V":
        said += f" at the panel, driven by {stimulus.handed_peak:.3g} V"
    limits = (("its voltage", stimulus.shaping), ("the measured panel", stimulus.moved))
    said += "".join(f", scaled to {of.scale:.1%} by the limit on {what}" for what, of in limits if of and of.scale < 1)
    said += f", with {stimulus.limited} samples clipped" if stimulus.limited else ""
    if stimulus.computed.left_out is not None:
        said += f", rms error {stimulus.computed.relative_error:.2%} ({stimulus.computed.left_out:.2%} left out)"
    if stimulus.moved is not None and (between := stimulus.moved.third_octave_between_db) is not None:
        said += f", worst third-octave error {between[0]:.1f} to {between[1]:.1f} dB"
    if stimulus.extrapolated:
        said += ", at a speed outside the recorded range"
    if (heard := stimulus.heard) is not None and heard.peak_m_s2 is not None:
        found = "" if heard.delay_ms is None else f", with the stimulus {heard.delay_ms:+.1f} ms from when it was due"
        said += f"; the accelerometer measured a peak of {heard.peak_m_s2:.3g} m/s^2{found}"
        said += "".join(f", and lost {lasts:g} ms of samples, {at:+g} ms from that time" for at, lasts in heard.lost_ms)
    return said if onset and onset.delivered else f"{said}; delivery was not measured"


def onset_line(onset: Onset | None) -> str:
    """Return what a transcript says of how a stimulus met the contact."""
    if onset is None:
        return ""
    said = ""
    if onset.prediction_error_ms is not None:
        said += f"; the predicted contact was {onset.prediction_error_ms:+.2f} ms off"
    if onset.ahead_ms is not None:
        said += f"; the onset was due {onset.ahead_ms:g} ms before contact, and was {onset.off_ms:+.2f} ms off"
    if onset.gate_to_scheduled_ms is not None:
        said += f"; the onset was scheduled {onset.gate_to_scheduled_ms:.2f} ms after the gate"
    if onset.delivered is None:
        return said
    heard = onset.delivered
    off = "no onset was measured"
    if heard.onset_error_ms is not None:
        off = f"the onset was {heard.onset_error_ms:+.3f} ms off the requested time"
    return f"{said}; {off}, {heard.xruns} xruns{'' if heard.delivered else f', undelivered: {heard.reason}'}"


def pressed_line(force: Pressed | None) -> str:
    """Return what a transcript says of how hard a foot pressed."""
    if force is None:
        return ""
    if force.mean_n is None or force.peak_n is None:
        return f"; the foot's force is unknown: {force.problem}"
    return f"; foot force: mean {force.mean_n:.1f} N, peak {force.peak_n:.1f} N"
