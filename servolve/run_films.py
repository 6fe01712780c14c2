"""Film strips of the best of some generations: how a run learnt."""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from controller import Controller, Rig
from controller.errors import InputError, RunError
from evolve.runs.record import Ancestor, GenerationSummary, controllers_of
from evolve.runs.run_file import RunFile, load_again
from evolve.task import Task

_FILMS: Final = 5  # the chosen best among them
_POSES: Final = 6
_WIDTH_PX: Final = 1500


@dataclass(frozen=True)
class Film:
    """Hold a film strip as a page shows it.

    Args:
        caption: what it shows
        data: the picture as a data URL
    """

    caption: str
    data: str


def films_of(
    folder: Path, found: RunFile, generations: Sequence[GenerationSummary], best: tuple[Ancestor, Controller]
) -> tuple[list[Film], str | None]:
    """Film the best of some generations, all with the same goal, and the best of the run last.

    Args:
        folder: the run's
        found: what its `run.toml` says
        generations: how each did
        best: the best of the run, and its controller

    Returns:
        the films, and why there are none or None
    """
    try:
        return _films(folder, found, generations, best), None
    except ModuleNotFoundError as error:
        return [], f"There are no film strips: {error.name} is not installed (pip install 'servolve[report]')."
    except (InputError, RunError) as error:
        return [], f"There are no film strips: {error}."


def _films(
    folder: Path, found: RunFile, generations: Sequence[GenerationSummary], best: tuple[Ancestor, Controller]
) -> list[Film]:
    chosen = filmed_generations([g.generation for g in generations], best[0].generation)
    places = [(generations[number].generation, generations[number].individual) for number in chosen]
    controllers = [*controllers_of(folder, places), best[1]]
    captions = [
        f"Generation {g.generation}: fitness {g.best:.3f}, hits {g.hits} of {g.conditions}"
        for g in (generations[number] for number in chosen)
    ]
    captions.append(f"The best of the run, from generation {best[0].generation}")
    task, rig = load_again(folder, found)
    return [
        Film(f"{caption}; {told}", data)
        for caption, controller in zip(captions, controllers, strict=True)
        for told, data in [_film(task, rig, found, controller)]
    ]


def filmed_generations(generations: Sequence[int], best: int) -> list[int]:
    """Choose generations whose best are filmed beside the best of the run: early ones more densely than late ones.

    Args:
        generations: all of them, from 0
        best: the one that the best of the run is from, which is left out

    Returns:
        at most four, in order
    """
    last = generations[-1]
    wanted = {round(last * share**2) for share in (0.0, 0.3, 0.6, 1.0)}
    return sorted(wanted - {best})[: _FILMS - 1]


def _film(task: Task, rig: Rig, found: RunFile, controller: Controller) -> tuple[str, str]:
    """Simulate a controller towards the middle of the goals, and draw it; return how it ended and the picture."""
    from PIL import Image

    from sim_models.film import motion_of, write_strip
    from sim_models.simulation import simulate

    settings = found.settings
    goal = (settings.goal_low_m + settings.goal_high_m) / 2
    simulation = simulate(
        controller,
        rig,
        goal_dist=goal,
        goal_bearing=(settings.bearing_low_rad + settings.bearing_high_rad) / 2,
        form=settings.decide_form,
        timestep_s=settings.decide_timestep_s,
        time_limit_s=settings.time_limit_s,
        stop=task.stop,
        scene=task.scene_with(settings),
    )
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "strip.png"
        write_strip(motion_of(simulation), path, _POSES)
        picture = Image.open(path).convert("RGB")
    height = round(picture.height * _WIDTH_PX / picture.width)
    # a film of few poses is not drawn larger than it is
    if picture.width > _WIDTH_PX:
        picture = picture.resize((_WIDTH_PX, height), Image.Resampling.LANCZOS)
    content = io.BytesIO()
    picture.save(content, "JPEG", quality=82)
    end = simulation.statistics
    error = 100 * float(end["final_error"])
    told = f"goal {100 * goal:.0f} cm ahead, ends {error:.1f} cm from it after {int(end['hops'])} hops"
    return told, f"data:image/jpeg;base64,{base64.b64encode(content.getvalue()).decode()}"
