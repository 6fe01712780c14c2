"""`servolve show RUN` and a run's report: complete, self-contained, at any moment of a run."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import shutil
import sqlite3
import sys
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from controller import format_source, load_controller
from controller.errors import InputError
from controller.source import Apply
from evolve import RunConfig, apply_overrides, evolve, load_task
from evolve.runs.history import open_history
from evolve.runs.record import ancestors_of_each_generation, best_of, controllers_of, generation_summaries, lineage
from evolve.runs.run_folder import locked
from servolve.cli import main
from servolve.run_films import filmed_generations
from servolve.run_report import read_record, run_report_html
from servolve.tree_picture import tree_svg

TASK = load_task("lamp-robust")
SMALL = ["population=16", "generations=4", "goals=2", "race_goals=1", "time_limit_s=0.6", "objectives=size"]
SMALL += ["decision_goals=3", "held_out_goals=5", "stated_goals=2", "hall_of_fame=6"]


def run(folder, generations=4, engine="gp"):
    def progress(told):
        if told.generation + 1 == generations < 4:
            raise KeyboardInterrupt

    return evolve(RunConfig(TASK, folder, 3, apply_overrides(TASK.settings, SMALL), None, 1, engine), progress)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "run"
    run(folder)
    return folder


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "run"
    with pytest.raises(KeyboardInterrupt):
        run(folder, 2, "gep")
    return folder


def shown(capsys, *arguments):
    assert main(["show", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_a_finished_run_tells_its_generations_lineage_and_program(finished, capsys):
    said = shown(capsys, finished)
    assert "finished, 4 generations" in said
    best = load_controller(finished)
    assert said.rstrip().endswith(format_source(best.source))
    validation = json.loads((finished / "validation.json").read_text())
    assert f"generation {validation['best']['generation']}, individual {validation['best']['individual']}" in said
    with sqlite3.connect(finished / "history.sqlite") as connection:
        fitnesses = [best for (best,) in connection.execute("select best from generation")]
    assert all(f"{fitness:.4f}" in said for fitness in fitnesses)


def test_an_interrupted_run_says_how_to_go_on(interrupted, capsys):
    said = shown(capsys, interrupted)
    assert f"interrupted, 2 of 4 generations; go on with servolve evolve --resume {interrupted}" in said
    assert "best so far" in said
    with locked(interrupted):
        assert "running, 2 of 4 generations" in shown(capsys, interrupted)


def test_a_run_that_has_not_begun_is_no_error_but_has_no_best(finished, tmp_path, capsys):
    shutil.copy(finished / "run.toml", tmp_path)
    assert "0 of 4 generations" in shown(capsys, tmp_path)
    (tmp_path / "history.sqlite").touch()
    assert "0 of 4 generations" in shown(capsys, tmp_path)
    assert main(["show", str(tmp_path), "--as", "tree"]) == 2
    assert "no generation yet" in capsys.readouterr().err


def test_the_best_is_shown_as_text_tree_picture_and_c(finished, interrupted, capsys):
    for folder in (finished, interrupted):
        assert "period" in shown(capsys, folder, "--as", "text")
        assert "└─" in shown(capsys, folder, "--as", "tree")
        assert "_step(" in shown(capsys, folder, "--as", "c")
        assert ElementTree.fromstring(shown(capsys, folder, "--as", "svg")).tag.endswith("svg")


def test_a_lineage_is_the_history_s_own(finished):
    generation, individual = best_of(finished)
    with open_history(finished / "history.sqlite") as connection:
        line = lineage(connection, generation, individual)
        counts = ancestors_of_each_generation(connection, generation, individual)
        everyone = {
            (g, i): json.loads(parents)
            for g, i, parents in connection.execute("select generation, individual, parents from evaluation")
        }
    assert [a.generation for a in line] == list(range(generation, -1, -1))
    assert line[-1].operator == "start" and line[-1].parents == ()
    for child, parent in itertools.pairwise(line):
        assert child.parents[0] == parent.individual
    alive = {individual}
    for number, count in zip(range(generation, -1, -1), counts, strict=True):
        assert count == len(alive)
        alive = {parent for child in alive for parent in everyone[number, child]}
    assert not alive


def test_the_recorded_genotype_is_the_controller_that_was_simulated(finished):
    origin = json.loads((finished / "validation.json").read_text())["best"]
    (again,) = controllers_of(finished, [(origin["generation"], origin["individual"])])
    assert again.source == load_controller(finished).source


def test_generations_sum_up_what_their_individuals_did(finished):
    with open_history(finished / "history.sqlite") as connection:
        for summary in generation_summaries(connection):
            rows = connection.execute(
                "select program, main + ? * style, conditions, hits from evaluation where generation = ?",
                (summary.phase, summary.generation),
            ).fetchall()
            complete = [fitness for _, fitness, conditions, _ in rows if conditions == 2]
            assert summary.best == min(complete)
            assert summary.distinct == len({program for program, *_ in rows})
            assert summary.hit_all == sum(hits == conditions == 2 for _, _, conditions, hits in rows)


class Page(HTMLParser):
    """Collect what a page shows and what it loads."""

    def __init__(self):
        super().__init__()
        self.headings, self.sources, self.text, self.pictures = [], [], [], 0
        self.inside = None

    def handle_starttag(self, tag, attrs):
        self.inside = tag
        self.pictures += tag == "svg"
        self.sources += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        (self.headings if self.inside == "h2" else self.text).append(data.strip())
        self.inside = None if self.inside == "h2" else self.inside


def parsed(path):
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def test_the_report_holds_everything_and_loads_nothing(finished, tmp_path):
    before = {path.name: path.read_bytes() for path in finished.iterdir()}
    assert main(["show", str(finished), "--report", str(tmp_path / "report.html")]) == 0
    page = parsed(tmp_path / "report.html")
    for heading in ("How it learnt", "Fitness", "Population", "Pareto front", "Held-out conditions", "Parameters"):
        assert heading in page.headings
    assert page.pictures >= 4
    assert all(source.startswith(("data:", "#")) for source in page.sources)
    cells = " ".join(page.text)
    for condition in json.loads((finished / "validation.json").read_text())["conditions"]:
        assert f"{100 * condition['final_error_m']:.2f}" in cells
    assert format_source(load_controller(finished).source).split("\n")[0] in cells
    assert {path.name: path.read_bytes() for path in finished.iterdir()} == before, "a report changes nothing else"


@pytest.mark.parametrize(
    ("hops", "told"),
    [
        ([0, 0, 0], "and does not hop,"),
        ([0, 2, 0], "hops in 1 of 3, 0.7 times on average"),
        ([4, 5, 3], "hops in 3 of 3, 4.0"),
    ],
)
def test_the_headline_counts_the_conditions_in_which_it_hops(finished, hops, told):
    record = read_record(finished)
    conditions = [dict(record.validation["conditions"][0], hops=count) for count in hops]
    held_out = dict(record.validation["held_out"], conditions=3, hops_mean=sum(hops) / 3, hops_min=min(hops))
    other = dataclasses.replace(record, validation={"held_out": held_out, "conditions": conditions})
    assert told in run_report_html(other, [], None)


def test_it_says_whether_generations_share_their_conditions(finished):
    record = read_record(finished)
    for redraw, told, not_told in (
        (True, "conditions of its own", "same conditions"),
        (False, "the same conditions", "own"),
    ):
        settings = dataclasses.replace(record.found.settings, redraw=redraw)
        other = dataclasses.replace(record, found=dataclasses.replace(record.found, settings=settings))
        (intro,) = re.findall(r"<h2>Fitness</h2>\s*<p[^>]*>(.*?)</p>", run_report_html(other, [], None))
        assert told in intro and not_told not in intro


def test_an_unfinished_run_has_a_report_too(interrupted, tmp_path):
    assert main(["show", str(interrupted), "--report", str(tmp_path / "report.html")]) == 0
    page = parsed(tmp_path / "report.html")
    assert "Held-out conditions" not in page.headings
    assert any("Not judged yet" in text for text in page.text)


def test_without_opengl_the_report_says_so(finished, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "none")
    assert main(["show", str(finished), "--report", str(tmp_path / "report.html")]) == 0
    page = parsed(tmp_path / "report.html")
    assert any("no film strips" in text and "OpenGL" in text for text in page.text)
    assert not any(source.startswith("data:image/jpeg") for source in page.sources)


def test_a_run_leaves_its_report_unless_told_not_to(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "none")
    arguments = ["evolve", "lamp-robust", "--quiet", "--threads", "1", *(f"--set={s}" for s in SMALL)]
    assert main([*arguments, "--out", str(tmp_path / "with")]) == 0
    assert "no film strips" in capsys.readouterr().err
    assert (tmp_path / "with" / "report.html").is_file()
    assert main([*arguments, "--out", str(tmp_path / "without"), "--no-report"]) == 0
    assert not (tmp_path / "without" / "report.html").exists()


@pytest.mark.parametrize("missing", ["matplotlib", "jinja2"])
def test_a_run_succeeds_without_what_reports_need(finished, tmp_path, monkeypatch, capsys, missing):
    monkeypatch.setenv("MUJOCO_GL", "none")
    monkeypatch.setitem(sys.modules, missing, None)
    shutil.copytree(finished, tmp_path / "run")
    assert main(["evolve", "--resume", str(tmp_path / "run"), "--quiet"]) == 0
    told = capsys.readouterr().err.splitlines()[-1]
    assert missing in told and "servolve[report]" in told and "--report" in told
    assert not (tmp_path / "run" / "report.html").exists()


def test_only_a_run_has_a_report(finished, tmp_path, capsys):
    assert main(["show", str(finished / "best.controller.toml"), "--report", str(tmp_path / "r.html")]) == 2
    assert main(["show", str(finished), "--report", str(tmp_path / "no" / "r.html")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2


def test_films_are_denser_where_more_is_learnt():
    assert filmed_generations(list(range(50)), 47) == [0, 4, 18, 49]
    assert filmed_generations([0], 0) == []
    assert filmed_generations([0, 1], 1) == [0]


def test_a_tree_picture_has_every_node_and_no_two_at_one_place(finished):
    controller = load_controller(finished)
    picture = ElementTree.fromstring(tree_svg(controller))
    boxes = [element for element in picture.iter() if element.tag.endswith("rect")]
    places = sorted((float(b.get("y")), float(b.get("x")), float(b.get("width"))) for b in boxes)

    def count(expression):
        return 1 + sum(count(operand) for operand in expression.operands) if isinstance(expression, Apply) else 1

    assert len(boxes) == sum(count(expression) for expression in controller.source.outputs)
    for (row, left, width), (next_row, next_left, _) in itertools.pairwise(places):
        assert row != next_row or left + width < next_left
    box = [float(number) for number in re.findall(r"[\d.]+", picture.get("viewBox"))]
    assert all(x >= 0 and x + width <= box[2] and y + 22 <= box[3] for y, x, width in places)


def test_a_missing_history_is_said(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "run")
    (tmp_path / "run" / "history.sqlite").unlink()
    with pytest.raises(InputError, match=r"history\.sqlite"), open_history(tmp_path / "run" / "history.sqlite"):
        pass
