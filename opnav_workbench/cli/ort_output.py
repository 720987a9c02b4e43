"""What ``opnav ort`` prints: tables of a solution and of a score."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from opnav_workbench.cli.terminal import plain_table
from opnav_workbench.rehearsal.ort_score import OrtScore
from opnav_workbench.rehearsal.ort_score_check import Check
from opnav_workbench.rehearsal.ort_solution import OrtSolution

__all__ = ["print_score", "print_solution"]

GOOD, POOR, WRONG = "green", "yellow", "bold red"
STYLES = {"good": GOOD, "poor": POOR, "A": GOOD, "B": GOOD, "C": POOR}


def print_solution(console: Console, solution: OrtSolution) -> None:
    """Print corrections and flyby, each with what was known before, and what is to be known of the fit."""
    table = plain_table(
        "Estimated, true minus predicted", ("quantity",), ("value", "sigma", "before", "unit")
    )
    rows = zip(
        solution.labels,
        solution.correction,
        solution.sigma,
        solution.sigma_before,
        solution.units,
        strict=True,
    )
    for label, *numbers, unit in rows:
        table.add_row(label.replace("_", " "), *(_number(n) for n in numbers), unit)
    flight = zip(
        ("B·T", "B·R", "time of flight"),
        solution.b_plane_shift,
        solution.b_plane_sigma,
        solution.b_plane_sigma_before,
        ("km", "km", "s"),
        strict=True,
    )
    for label, *numbers, unit in flight:
        table.add_row(label, *(_number(n) for n in numbers), unit)
    console.print(table)
    console.print(
        f"chi-squared {solution.chi2_after:.1f} for {solution.degrees_of_freedom} degrees of freedom, probability "
        f"{solution.probability:.2g}",
        highlight=False,
    )
    for words in solution.messages:
        console.print(f"[yellow]note[/] {escape(words)}", highlight=False, soft_wrap=True)
    for words in solution.left_out:
        console.print(f"left out: {escape(words)}", highlight=False, soft_wrap=True, style="dim")


def print_score(console: Console, score: OrtScore) -> None:
    """Print what was wrong, how the solution compares, the points, and the grade."""
    for words in score.perturbed:
        console.print(f"wrong on purpose: {escape(words)}", highlight=False, soft_wrap=True)
    if score.solution is not None:
        table = plain_table(
            "Solution against truth", ("quantity",), ("solved", "true", "error", "sigma", "error / σ", "unit")
        )
        for check in (score.solution.b_plane, score.solution.arrival, *score.solution.parameters):
            _add_check(table, check)
        console.print(table)
    points = plain_table("Points", ("section",), ("points", "of"))
    points.add_column("lost by")
    for section in score.grade.sections:
        points.add_row(
            section.name,
            f"{section.earned:.1f}",
            f"{section.possible:.0f}",
            escape("; ".join(section.losses)),
        )
    console.print(points)
    for fault in score.grade.faults:
        console.print(
            f"[bold red]at most {fault.letter}:[/] {escape(fault.words)}", highlight=False, soft_wrap=True
        )
    letter = score.grade.letter
    console.print(
        f"Grade [{STYLES.get(letter, WRONG)}]{letter}[/], {score.grade.points:.0f} of 100 points",
        highlight=False,
    )


def _add_check(table: Table, check: Check) -> None:
    style = STYLES.get(check.verdict, WRONG)
    rows = zip(
        check.labels,
        check.solved,
        check.truth,
        check.error,
        check.sigma,
        check.component_sigmas,
        check.units,
        strict=True,
    )
    for label, *numbers, sigmas, unit in rows:
        name = f"{check.name.replace('_', ' ')} {label}".strip()
        table.add_row(name, *(_number(n) for n in numbers), f"[{style}]{sigmas:+.2f}[/]", unit)


def _number(value: float) -> str:
    return f"{value:,.3f}" if abs(value) >= 0.1 else f"{value:.3g}"
