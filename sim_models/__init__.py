"""Bodies, servo physics, rollouts and films."""

from sim_models.body import build_model, settled_data
from sim_models.perturbations import PerturbationRanges, Perturbations, draw_perturbations, nominal_perturbations
from sim_models.rollouts import Cases, RolloutPool, Rollouts, StopConditions, make_cases
from sim_models.servo import ServoParameters, servo_parameters, set_servo
from sim_models.simulation import Simulation, simulate

__all__ = [
    "Cases",
    "PerturbationRanges",
    "Perturbations",
    "RolloutPool",
    "Rollouts",
    "ServoParameters",
    "Simulation",
    "StopConditions",
    "build_model",
    "draw_perturbations",
    "make_cases",
    "nominal_perturbations",
    "servo_parameters",
    "set_servo",
    "settled_data",
    "simulate",
]
