"""A flight with the alarm in the loop: the model and the drone synchronised, and a film of both."""

import math
from pathlib import Path
from typing import Any

import cv2

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.plots.film import PANEL_WH, AvoidanceFilm, FlightTrace
from dlgmd_cli.results.csv import table_of, write_values
from dlgmd_cli.results.store import claimed
from dlgmd_cli.results.synth import RenderedClip
from dlgmd_cli.scenes.flights.braking import Brakes, FlightInLoop
from dlgmd_cli.scenes.flights.scenes import FlightOptions, FlightScene
from dlgmd_cli.scenes.flights.truth import Target
from dlgmd_cli.tasks.call import OnFrame
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

COLUMNS = (
    *("flight", "frame", "time_s", "distance_m", "time_to_contact_s"),
    *("mp_abs", "spike", "expansion", "ttc_s", "rule", "threshold", "alarm"),
)
_ENDS = ("-avoid.mp4", "-avoid.png", "-avoid.csv")


def avoid(
    scene: Any,
    options: FlightOptions,
    preset: str,
    folder: Path,
    name: str,
    *,
    overwrite: bool,
    on_frame: OnFrame,
) -> RenderedClip:
    """Fly a flight without and with an alarm, and film both side by side.

    Returns the table of both flights, what came of the stop, and the files: the film, its image
    at the collision, and the table.
    """
    if not isinstance(scene, FlightScene):
        why = f"{argument('avoid')} works only with flights, and {scene.name} is not one"
        raise ParameterError("", why)
    alarms = [Alarm(preset), Alarm(preset)]
    paths = tuple(folder / f"{name}{end}" for end in _ENDS)
    with claimed(folder, names=[path.name for path in paths], overwrite=overwrite) as claim:
        flights: list[tuple[FlightInLoop, list[list[Any]], list[Any]]] = []
        for brakes, alarm in zip((False, True), alarms, strict=True):
            flight = FlightInLoop(scene, options, Brakes())
            n_before = sum(len(rows) for _, rows, _ in flights)
            flights.append((flight, *_flown(flight, alarm, on_frame, n_before, brakes=brakes)))
        without, loop = flights
        facts = _facts(without[0], loop[0])
        both = (
            _series(f"Without: {facts['without']}", *without[1:]),
            _series(f"With the alarm: {facts['with']}", *loop[1:]),
        )
        film = AvoidanceFilm(both, alarms[0].rule, preset)
        last, end = facts["collision_frame"], film.n_frames - 1
        codec, fps = best_codec(), playable_fps(options.fps)
        look: Any = {"codec": codec, "is_colour": True, "target": paths[0]}
        with claim.staged(what=paths[0]) as stage:
            temporary = [stage / path.name for path in paths]
            with video_writer(temporary[0], film.shape, fps, **look) as write:
                for index in range(film.n_frames):
                    cancel.check()
                    write(film.picture(index))
            still = film.picture(end if last is None else min(end, last))
            temporary[1].write_bytes(cv2.imencode(".png", still)[1].tobytes())
            rows = [["without", *row] for row in without[1]] + [["with", *row] for row in loop[1]]
            write_values(temporary[2], COLUMNS, rows)
    record = {"avoid": preset, **facts}
    return RenderedClip(scene.name, options.fps, table_of(COLUMNS, rows), record, paths=paths)


def _flown(
    flight: FlightInLoop, alarm: Alarm, on_frame: OnFrame, n_before: int, *, brakes: bool
) -> tuple[list[list[Any]], list[Any]]:
    """The rows of a flight without its name, and its images; `n_before` frames are done."""
    rows: list[list[Any]] = []
    pictures: list[Any] = []
    for number, frame in enumerate(flight):
        cancel.check()
        seen = alarm.step(frame, flight.time_s)
        if seen.alarm and brakes:
            flight.brake()
        compared = (
            seen.mp_abs,
            seen.spike,
            seen.expansion,
            seen.ttc_s,
            seen.rule,
            alarm.rule.threshold,
        )
        rows.append([number, flight.time_s, *compared, seen.alarm])
        pictures.append(cv2.resize(frame, PANEL_WH, interpolation=cv2.INTER_LINEAR))
        on_frame(n_before + number + 1)
    stage, target = flight.stage, Target(flight.stage)
    for row in rows:
        distance, *_ = target.seen_from(stage.path.state(row[1]), row[1])
        left = math.nan if stage.contact_s is None else stage.contact_s - row[1]
        row[2:2] = [distance, left if left >= 0.0 else math.nan]
    return rows, pictures


def _series(title: str, rows: list[list[Any]], pictures: list[Any]) -> FlightTrace:
    """The rows of a flight as the film takes them."""
    flown = table_of(COLUMNS[1:], rows)
    names = "time_s", "mp_abs", "expansion", "time_to_contact_s", "ttc_s", "alarm"
    time_s, mp_abs, expansion, contact_s, ttc_s, alarm = (flown[name] for name in names)
    return FlightTrace(title, time_s, mp_abs, expansion, contact_s, ttc_s, alarm, pictures)


def _facts(without: FlightInLoop, loop: FlightInLoop) -> dict[str, Any]:
    """What came of the flight and of the stop, in words and numbers."""
    stage, braked = without.stage, loop.braked
    contact_s = stage.contact_s
    flown = "no collision" if contact_s is None else f"hits at {without.speed_m_s:.1f} m/s"
    frame = None if contact_s is None else math.ceil(contact_s * without.fps - 1e-6)
    facts = {"without": flown, "with": flown, "collision_frame": frame, "saved": None}
    if braked is None:
        return facts | {"with": f"no alarm; {flown}"}
    stop = braked.stop
    said = f"hits at {stop.impact_m_s:.1f} m/s"
    if stop.saved:
        said = f"stops {stop.stopped_m:.2f} m before"
        if contact_s is None:
            said = "a stop for a real obstacle" if braked.justified else "a false stop"
    return facts | {
        "with": said,
        "alarm_s": braked.alarm_s,
        "lead_s": None if contact_s is None else contact_s - braked.alarm_s,
        "saved": stop.saved if contact_s is not None else None,
        "impact_m_s": None if math.isnan(stop.impact_m_s) else stop.impact_m_s,
        "stopped_m": None if math.isnan(stop.stopped_m) else stop.stopped_m,
        "justified": braked.justified,
    }
