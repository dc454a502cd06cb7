"""Rows judged by a rule after the last frame."""

from dlgmd_cli.models.columns import columns_of
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.rules import Rule
from dlgmd_cli.results.csv import KNOWN, Rows


def judged(rows: Rows, rule: Rule) -> Rows:
    """The rows with the spikes, signals and alarms of a rule, as if it had stepped each new row."""
    rows, row = rows.copy(), Detection()
    names = [one.name for one in columns_of(Detection)]
    for place, values in enumerate(rows.tolist()):
        known = dict(zip(rows.dtype.names or (), values, strict=True))
        if place == 0 or known["gap"]:
            rule.restart()
        if not known["repeat"]:
            own = {name: value for name, value in known.items() if name not in KNOWN}
            row = rule.step(Detection(**{name: known[name] for name in names}, more=own))
        for name in ("spike", "signal", "signal_limit", "alarm"):
            rows[name][place] = getattr(row, name)
    return rows
