"""All exhibits of a report by id, and the plans under which each is shown."""

from dataclasses import replace
from pathlib import Path

from dlgmd_cli.reproduce import ablation, flights, objects, stimuli, table4
from dlgmd_cli.reproduce.plan import FULL_SIZE, Exhibit, Plan

EXHIBITS: dict[str, Exhibit] = (
    stimuli.EXHIBITS | objects.EXHIBITS | flights.EXHIBITS | table4.EXHIBITS | ablation.EXHIBITS
)
# Exhibits that are checked at the paper's frame size, and those with frames by the authors.
AT_FULL_SIZE = {*flights.EXHIBITS, "table4-da"} - {"lateral"}
OF_AUTHORS = {"fig8": "ball_and_capsules", "fig10": "looming_ball", "fig12": "looming_ball"}


def plans_of(name: str, plan: Plan, reference: Path | None) -> list[Plan]:
    """The plan of an exhibit, then those that are shown beside it.

    `reference` is the folder of the authors' frames, if it is given.
    """
    plans = [plan]
    if name in AT_FULL_SIZE and not (plan.quick or plan.is_larger):
        plans.append(replace(plan, flight_size=FULL_SIZE, only_seeds=plan.only_seeds[:6]))
    if reference is not None and name in OF_AUTHORS and (reference / OF_AUTHORS[name]).is_dir():
        plans.append(replace(plan, reference=reference))
    return plans
