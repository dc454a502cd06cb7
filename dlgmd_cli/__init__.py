"""The D-LGMD, a model of a locust's neuron, over video, with alarms by the image's expansion.

>>> import dlgmd_cli
>>> result = dlgmd_cli.run("flight.mp4", 9)  # doctest: +SKIP
"""

import os
from importlib import import_module

__version__ = "3.0.0"

# Number of packets in a row of other streams, such as sound, that OpenCV skips: after its 4,096, a
# video ends at a pause. OpenCV reads the number when the process opens its first video.
os.environ.setdefault("OPENCV_FFMPEG_READ_ATTEMPTS", "10000000")

# This module imports little, not even `typing`: Ctrl-C is handled only once it is loaded.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from dlgmd_cli.errors import DlgmdError as DlgmdError
    from dlgmd_cli.errors import DlgmdWarning as DlgmdWarning
    from dlgmd_cli.microcontroller.export import export as export
    from dlgmd_cli.models.alarm import Alarm as Alarm
    from dlgmd_cli.models.base import Layers as Layers
    from dlgmd_cli.models.base import Model as Model
    from dlgmd_cli.models.base import Photoreceptors as Photoreceptors
    from dlgmd_cli.models.base import Response as Response
    from dlgmd_cli.models.detection import Detection as Detection
    from dlgmd_cli.models.dlgmd import DLGMD as DLGMD
    from dlgmd_cli.models.emd_lgmd import EmdLGMD as EmdLGMD
    from dlgmd_cli.models.lgmd import LGMD as LGMD
    from dlgmd_cli.models.on_off import OnOffDLGMD as OnOffDLGMD
    from dlgmd_cli.models.rules import Rule as Rule
    from dlgmd_cli.pages.view import view as view
    from dlgmd_cli.parameters.keys import Parameters as Parameters
    from dlgmd_cli.parameters.keys import key as key
    from dlgmd_cli.parameters.presets import DlgmdParameters as DlgmdParameters
    from dlgmd_cli.parameters.presets import OnOffParameters as OnOffParameters
    from dlgmd_cli.parameters.presets import load_config as load_config
    from dlgmd_cli.parameters.presets import load_set as load_set
    from dlgmd_cli.results.looming import looming_fit as looming_fit
    from dlgmd_cli.results.looming import peak_before_contact as peak_before_contact
    from dlgmd_cli.results.reading import read_comparison as read_comparison
    from dlgmd_cli.results.reading import read_result as read_result
    from dlgmd_cli.results.reading import read_results as read_results
    from dlgmd_cli.results.result import Result as Result
    from dlgmd_cli.tasks.batch.batch import batch as batch
    from dlgmd_cli.tasks.calibrate import calibrate as calibrate
    from dlgmd_cli.tasks.compare import compare as compare
    from dlgmd_cli.tasks.evaluate.evaluate import evaluate as evaluate
    from dlgmd_cli.tasks.info import info as info
    from dlgmd_cli.tasks.layers import layers as layers
    from dlgmd_cli.tasks.plot import plot as plot
    from dlgmd_cli.tasks.run import run as run
    from dlgmd_cli.tasks.sets import sets as sets
    from dlgmd_cli.tasks.sweep.sweep import sweep as sweep
    from dlgmd_cli.tasks.sweep.sweep import sweeps as sweeps
    from dlgmd_cli.tasks.synth import synth as synth
    from dlgmd_cli.video.opening import open_video as open_video
    from dlgmd_cli.watch.live import live as live

# Imported on first use: `dlgmd --help` must not wait for NumPy and OpenCV.
_TASKS = "compare info layers plot run sets synth"
_NAMES = {
    **{f"tasks.{name}": name for name in _TASKS.split()},
    "errors": "DlgmdError DlgmdWarning",
    "parameters.keys": "Parameters key",
    "microcontroller.export": "export",
    "models.alarm": "Alarm",
    "models.base": "Layers Model Photoreceptors Response",
    "models.detection": "Detection",
    "models.dlgmd": "DLGMD",
    "models.emd_lgmd": "EmdLGMD",
    "models.lgmd": "LGMD",
    "models.on_off": "OnOffDLGMD",
    "models.rules": "Rule",
    "pages.view": "view",
    "parameters.presets": "DlgmdParameters OnOffParameters load_config load_set",
    "results.looming": "looming_fit peak_before_contact",
    "results.reading": "read_comparison read_result read_results",
    "results.result": "Result",
    "tasks.batch.batch": "batch",
    "tasks.calibrate": "calibrate",
    "tasks.evaluate.evaluate": "evaluate",
    "tasks.sweep.sweep": "sweep sweeps",
    "video.opening": "open_video",
    "watch.live": "live",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = [*_HOMES]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*_HOMES, "__version__"])
