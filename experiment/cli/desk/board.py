"""What a study's board decides and has to be told, at the desk."""

from palpate.experiment.cli.desk.study import Study, as_findings, day_field, deed, one_of
from palpate.experiment.desk.console.home import NO, Deed, Field
from palpate.experiment.errors import Finding
from palpate.experiment.protocol import approval
from palpate.experiment.study import amendment, approvals


def amend(study: Study) -> Deed:
    """Return what records another approval, with the fields of an amendment or of a renewal."""
    refuses, first = study.unfilled or study.unsealed, "edit" if study.unfilled else "seal"
    begun, renewal = bool(study.roster.consent_on), False
    if not begun:
        refuses, first = (Finding("nobody is enrolled, so no amendment is needed: edit the protocol"),), ""
    elif not refuses:
        known = study.roster.approvals(approvals.read_first(study.root))
        renewal = known.version_of(approval.sha256(study.protocol)) is not None
        refuses, first = as_findings(lambda: amendment.plan_approval(study.file, root=study.root)), ""
    fields = (
        ()
        if renewal
        else (
            Field("In progress", "--in-progress", "session", check=one_of("old", "session", "new")),
            Field("Consent again", "--reconsent", "everybody", check=one_of("everybody", "nobody")),
        )
    )
    hint = (
        "In progress: participants who have begun finish all tasks (old), only the current session (session), or no "
        "more trials (new) under the old version."
    )
    return deed(
        "amend",
        "amend",
        str(study.file),
        *study.dataset,
        fields=(*fields, day_field("From", "--from", wanted=False)),
        hint="Empty: from today." if renewal else hint,
        refuses=refuses,
        first=first,
    )


def suspend(study: Study) -> Deed:
    """Return what records a suspension, its lift, or the study's end: one of the three days."""
    fields = (
        day_field("Suspended on", "--suspended-on", wanted=False),
        day_field("Lifted on", "--lifted-on", wanted=False),
        day_field("Ended on", "--ended-on", wanted=False),
        Field("Reason", "--reason"),
    )
    hint = "Fill in one day (YYYY-MM-DD) and the reason, without names. Ending a study cannot be undone."
    return _of_begun(study, "suspend", "amend", fields, hint)


def incident(study: Study) -> Deed:
    """Return what records an adverse event or a deviation."""
    fields = (
        Field("Adverse event", "--adverse", wanted=False),
        Field("Deviation", "--deviation", wanted=False),
        Field("Done", "--done"),
        day_field("Happened on", "--on", str(study.today)),
        day_field("Board informed on", "--informed-on", wanted=False),
        Field("Participant", "--participant", wanted=False),
        Field("Took part", "--took-part", wanted=False),
        Field("Exchanged", "--exchanged", NO, flag=True),
    )
    hint = "Fill in one of the first two, without names. The journal of the participant's latest session gets a note."
    hint += (
        " Took part: TASK=LABEL of the person who did that session. Exchanged: the two took part under each other's "
        "labels."
    )
    return _of_begun(study, "incident", "incident", fields, hint)


def _of_begun(study: Study, name: str, command: str, fields: tuple[Field, ...], hint: str) -> Deed:
    refuses = () if study.roster.consent_on else (Finding("nobody is enrolled"),)
    return deed(
        name, command, str(study.file), *study.dataset, fields=fields, hint=hint, refuses=refuses, first="enrol"
    )
