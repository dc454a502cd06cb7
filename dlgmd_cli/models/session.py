"""From the frames of a source to detections: models, the measured expansion, and alarm rules."""

import math
from collections.abc import Callable, Sequence

from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion, Measured
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.models.rules import Rule, Seen, rule_of
from dlgmd_cli.models.windows import Direction

# What a step may leave out.
NEURON, EXPANSION = "neuron", "expansion"


class Session:
    """Processes the frames of one source with models, the expansion, and the models' rules.

    A session skips duplicates and restarts after a gap in time. Nothing else resets its models.

    Parameters
    ----------
    models : sequence of Model
        The models, with their ignored cells already set, see `Model.ignore`.
    expansion : Expansion, optional
        The measurement on the frames' `small` images, common to all models. Without a measurement
        or a `small` image, the expansion is NaN.
    sizes_wh : sequence of (int, int)
        Width and height of the frames of each model, if a source gives several sizes.
    headings : callable, optional
        Frame number -> direction of flight, None if unknown.

    Attributes
    ----------
    models, expansion
        As given.
    rules : list of Rule
        The rule of each model's alarm.
    """

    def __init__(
        self,
        models: Sequence[Model],
        expansion: Expansion | None = None,
        sizes_wh: Sequence[tuple[int, int]] = (),
        headings: Callable[[int], Direction | None] | None = None,
    ) -> None:
        self.models, self.expansion, self._headings = [*models], expansion, headings
        self.sizes_wh: list[tuple[int, int] | None] = [*sizes_wh] or [None] * len(self.models)
        self.rules = [rule_of(model.params) for model in self.models]
        self._forget()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        for model in self.models:
            model.reset()
        for rule in self.rules:
            rule.reset()
        if self.expansion is not None:
            self.expansion.reset()
        self._forget()

    def _forget(self) -> None:
        self._answers = [Detection(rule=rule.name) for rule in self.rules]
        self._restarts, self._left_out = False, ""

    def step(self, frame: Frame, *, layers: bool = False, left_out: str = "") -> list[Detection]:
        """The answer of each model to the next frame; for a duplicate, the previous answers.

        Parameters
        ----------
        frame : Frame
            The frame, with its time, and whether it is a duplicate or follows a gap.
        layers : bool
            Whether the answers contain the layers; answers to duplicates contain none.
        left_out : str
            `NEURON` or `EXPANSION`, whose numbers are NaN then; it restarts once it is not left
            out any more.

        Raises
        ------
        FrameError, MissingExtraError
            As `Model.step`.
        """
        self._restarts = self._restarts or frame.after_gap
        if frame.is_repeat:
            return self._answers
        if self._restarts:
            self.reset()
        time_s = None if math.isnan(frame.time_s) else frame.time_s
        if left_out != self._left_out:
            self._restart(self._left_out)
        self._left_out = left_out
        responses = [
            model.step(frame.at(size_wh), time_s, layers=layers)
            if left_out != NEURON
            else Response()
            for model, size_wh in zip(self.models, self.sizes_wh, strict=True)
        ]
        measured = Measured()
        if self.expansion is not None and frame.small is not None and left_out != EXPANSION:
            if self._headings is not None:
                self.expansion.head(self._headings(frame.index))
            measured = self.expansion.step(frame.small, time_s)
        self._answers = [
            _detected(model, rule, response, measured)
            for model, rule, response in zip(self.models, self.rules, responses, strict=True)
        ]
        return self._answers

    def _restart(self, part: str) -> None:
        """Make a part that was left out forget all earlier frames."""
        for model in self.models if part == NEURON else ():
            model.reset()
        if self.expansion is not None and part == EXPANSION:
            self.expansion.reset()


def _detected(model: Model, rule: Rule, response: Response, measured: Measured) -> Detection:
    """A model's response and the expansion, with the rule's spike and alarm."""
    mp_abs = float(absolute(response.mp, model.n_cells, model.params.kappa))
    spike, alarm = rule.step(
        Seen(
            mp_abs,
            measured.ttc_s,
            measured.expansion,
            approach=measured.approach,
            quality=measured.expansion_quality,
            across=measured.expansion_across,
        )
    )
    return Detection(
        p_sum=response.p_sum,
        s_sum=response.s_sum,
        mp=response.mp,
        ffi=response.ffi,
        t_de=response.t_de,
        layers=response.layers,
        g_x=response.g_x,
        g_y=response.g_y,
        more=response.more,
        expansion=measured.expansion,
        expansion_across=measured.expansion_across,
        ttc_s=measured.ttc_s,
        expansion_x=measured.expansion_x,
        expansion_y=measured.expansion_y,
        expansion_quality=measured.expansion_quality,
        approach=measured.approach,
        mp_abs=mp_abs,
        spike=spike,
        alarm=alarm,
        rule=rule.name,
    )
