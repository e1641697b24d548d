"""The records of a benchmark's standings; `standings` computes them and says how."""

from __future__ import annotations

from dataclasses import dataclass

from hil.campaigns.contests import Entrant


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with its limits of 95 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Course:
    """A window of a scenario on a rig: the course on which entrants are compared."""

    rig: str
    scenario: str
    window: str

    @property
    def name(self) -> str:
        """Scenario and window."""
        return f"{self.scenario}: {self.window}"


@dataclass(frozen=True, slots=True)
class Standing:
    """An entrant on a course.

    runs, ended : how many seeds, and how many of them reached the window's end. endings : cause of each that did not,
    with their number. iae_Vs, peak_V, settling_s, overshoot_V, noise_V : (2,) medians over the runs that ended;
    settling_s None where more than half did not settle. unsettled : (2,) how many. worst_overshoot_V : of all runs.
    energy_V2s : median. ratio, rank : see `standings`. quiet_ratio : median score over the lowest median score of an
    entrant with no more noise.
    """

    entrant: Entrant
    course: Course
    runs: int
    ended: int
    endings: dict[str, int]
    iae_Vs: tuple[float | None, float | None]
    settling_s: tuple[float | None, float | None]
    unsettled: tuple[int, int]
    overshoot_V: tuple[float | None, float | None]
    worst_overshoot_V: float | None
    peak_V: tuple[float | None, float | None]
    noise_V: float | None
    energy_V2s: float | None
    ratio: Interval
    rank: Interval
    quiet_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class Detection:
    """How an entrant's detector did in the scenarios with faults.

    faults : runs whose fault was played; found, right : how many of them. delay_s, over_bound_s, over_bound : medians
    of the delay, and of the delay minus and over the bound where there is one. false_alarms : in all runs.
    """

    entrant: Entrant
    scenario: str
    faults: int
    found: int
    right: int
    delay_s: float | None
    bound_s: float | None
    over_bound_s: float | None
    over_bound: float | None
    false_alarms: int


@dataclass(frozen=True, slots=True)
class Overall:
    """An entrant over all courses of its rig.

    ratio : geometric mean of its ratios. rank : mean of its ranks. tripped, stopped, crashed : runs. noise_V : median
    over the runs that have the noise window, the larger of the pumps. ahead : courses on which it is the best.
    """

    entrant: Entrant
    runs: int
    tripped: int
    stopped: int
    crashed: int
    noise_V: float | None
    ratio: Interval
    rank: Interval
    ahead: int
    courses: int


@dataclass(frozen=True)
class Standings:
    """All of a benchmark."""

    seeds: tuple[int, ...]
    of_courses: tuple[Standing, ...]
    overall: tuple[Overall, ...]
    detections: tuple[Detection, ...]

    def on(self, course: Course) -> tuple[Standing, ...]:
        """The standings on one course."""
        return tuple(one for one in self.of_courses if one.course == course)

    @property
    def courses(self) -> tuple[Course, ...]:
        """All courses, in order."""
        return tuple(dict.fromkeys(one.course for one in self.of_courses))

    @property
    def rigs(self) -> tuple[str, ...]:
        """All rigs, in order."""
        return tuple(dict.fromkeys(one.entrant.rig for one in self.overall))
