"""Running a scenario, once or many times over processes; the results do not depend on how many."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import Any

from soopnav_cpp.experiments.registry import Step, Workers, derive_seed
from soopnav_cpp.scenarios.base import Scenario, System, SystemRun
from soopnav_cpp.scenarios.metrics import Series, evaluate

__all__ = ["Outcome", "execute", "seed_of_run"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one run left.

    Attributes
    ----------
    number : int
        From 1.
    seed : int
        Of this run alone.
    series : Series or None
        None when the run failed.
    run : SystemRun or None
        Kept for the first run that is asked for.
    notes : tuple of str
        Of the run.
    error : str
        Why it failed, one sentence; empty when it did not.
    details : str
        The traceback.
    """

    number: int
    seed: int
    series: Series | None = None
    run: SystemRun | None = None
    notes: tuple[str, ...] = ()
    error: str = ""
    details: str = ""

    def __str__(self) -> str:
        return f"run {self.number} (seed {self.seed}): {self.error or 'done'}"


def seed_of_run(scenario: Scenario, number: int) -> int:
    """Seed of the run of this number, from 1.

    It depends on the scenario's seed, its system and the number: scenarios of one system that differ in their
    parameters draw the same random numbers, which makes them comparable run by run.
    """
    return derive_seed(scenario.seed, scenario.system, number)


def _one(system: System, scenario: Scenario, number: int, keep: bool) -> Outcome:
    seed = seed_of_run(scenario, number)
    try:
        run = system.run(scenario, seed)
        if run.origin_lla_deg is None and scenario.origin is not None:
            place = scenario.origin
            run = replace(run, origin_lla_deg=(place.latitude_deg, place.longitude_deg, place.height_m))
        series = evaluate(run, start_s=scenario.metrics_start_s)
    except Exception as error:  # one run that fails does not take the others with it
        text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return Outcome(number, seed, error=text, details=traceback.format_exc())
    return Outcome(number, seed, series=series, run=run if keep else None, notes=run.notes)


def execute(
    system: System,
    scenario: Scenario,
    *,
    jobs: int = 1,
    only: int | None = None,
    step: Step | None = None,
    failed: Callable[[Outcome], Any] | None = None,
) -> list[Outcome]:
    """All runs of a scenario, in the order of their numbers.

    Parameters
    ----------
    system : System
        When `jobs` is more than 1: of a class at module level.
    scenario : Scenario
    jobs : int
        Processes.
    only : int, optional
        Only the run of this number, with the seed that it has among all.
    step : callable, optional
        Told how far it has come.
    failed : callable, optional
        Told at once of a run that failed.

    Returns
    -------
    list of Outcome
        The first good one keeps its `run`: with several processes, or where run 1 failed, it is run once more here.
    """
    if only is not None and only < 1:
        raise ValueError(f"only = {only}: the number of a run, from 1, expected")
    numbers = [only] if only is not None else list(range(1, scenario.runs + 1))
    outcomes: list[Outcome] = []

    def take(outcome: Outcome) -> None:
        outcomes.append(outcome)
        if outcome.error and failed is not None:
            failed(outcome)
        if step is not None:
            step(f"run {len(outcomes)} of {len(numbers)}", done=len(outcomes), total=len(numbers))

    if step is not None:
        step(f"run 1 of {len(numbers)}", done=0, total=len(numbers))
    with Workers(jobs) as workers:
        try:
            # What a run holds beside its numbers need not be able to leave its process.
            calls = [(system, scenario, n, jobs == 1 and n == numbers[0]) for n in numbers]
            for outcome in workers.map(_one, calls, chunk=1):  # runs take long: the bar moves with each
                take(outcome)
        except BrokenProcessPool:
            for number in numbers[len(outcomes) :]:
                take(Outcome(number, seed_of_run(scenario, number), error="its process died (out of memory?)"))
    good = [outcome for outcome in outcomes if not outcome.error]
    if good and not any(outcome.run is not None for outcome in good):
        again = _one(system, scenario, good[0].number, True)
        outcomes[outcomes.index(good[0])] = again
    return outcomes
