"""The report: one self-contained page, made of sections that each command puts together.

A section is a template ``sections/<name>.html.j2`` and the data that it shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orthoglide.geometry import LEGS
from orthoglide.numerals import compact, plain
from orthoglide.report.embed import panels, whole
from orthoglide.report.figures import Drawing
from orthoglide.report.rows import Calibrated, controller_rows, parameter_rows, score_rows
from orthoglide.report.run import Run
from orthoglide.report.wording import explained_by, headline, listed, sentence, weak_sentences

if TYPE_CHECKING:
    from orthoglide.fit import Estimate

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """One section of a page.

    Attributes:
        template: name under ``templates/sections``.
        title: its heading, also the anchor's text; empty for the verdict at the top.
        data: what the template shows.
    """

    template: str
    title: str
    data: Data = field(default_factory=dict)


@dataclass(frozen=True)
class Page:
    """A page to render.

    Attributes:
        title: of the page.
        subtitle: what was measured.
        sections: in their order.
        run: for the last lines.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    run: Run


def render(page: Page) -> str:
    """The page as HTML."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("orthoglide.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html.j2").render(page=page)


def identification_page(estimate: Estimate, run: Run, drawings: Sequence[Drawing]) -> str:
    """The report of an identification."""
    figures = {d.name: d for d in drawings}
    sections = [
        Section("verdict", "", _verdict(estimate)),
        Section("controller", "Numbers for the controller", controller_data(estimate)),
        Section("parameters", "What was identified", _parameters(estimate, figures)),
        Section("fit", "Before and after", _fit(estimate, figures)),
        Section("readings", "Readings and fit, setup by setup", readings_data(figures)),
        Section("weak", "What these readings cannot tell", _weak(estimate, figures)),
        Section("method", "How this was computed", method_data(estimate, run)),
    ]
    kept = [s for s in sections if s.template != "controller" or s.data["rows"]]
    campaigns = estimate.problem.campaigns
    count = sum(map(len, campaigns))
    setups = estimate.problem.setup_count
    subtitle = f"{listed(i.file for i in run.inputs)}: {count} readings in {setups} setups"
    return render(Page("Calibration report", subtitle, kept, run))


_SAID_ABOVE = "the residuals are"  # the sentence and what follows it say so already


def _verdict(estimate: Estimate) -> Data:
    noise = estimate.problem.noise.typical * 1e3
    tiles = [
        ("Deviations before", f"{estimate.nominal.deviation_rms * 1e3:.3f}", "mm rms"),
        ("Deviations after", f"{estimate.scores.deviation_rms * 1e3:.3f}", "mm rms"),
        ("Noise of a reading", compact(noise, 2), "mm, sigma"),
    ]
    return {
        "sentence": headline(estimate),
        "tiles": tiles,
        "lacking": estimate.sigma_scale > 1,
        "scale": f"{estimate.sigma_scale:.2g}",
        "families": explained_by(estimate),
        "warnings": [sentence(w) for w in estimate.warnings if not w.startswith(_SAID_ABOVE)],
    }


def controller_data(estimate: Calibrated) -> Data:
    """Numbers for the controller, for their section."""
    spec = estimate.machine.spec
    rows = controller_rows(estimate)
    others = any(v for n, v in estimate.machine.values.items() if "joint_offset." not in n)
    return {
        "rows": rows,
        "standard": spec.controller.sign == (1, 1, 1) and not any(spec.controller.zero),
        "length": plain(spec.geometry.L * 1e3, 3),
        "effect": _effect_of_others(estimate) if others else None,
    }


def _effect_of_others(estimate: Calibrated) -> str:
    """How far the TCP is off, at Zero and the ends, where only the offsets are told: in mm."""
    import numpy as np

    machine = estimate.machine
    spec = machine.spec
    offsets = {n: v for n, v in machine.values.items() if n.startswith("joint_offset.")}
    bare = machine.with_only(offsets)
    names = ("zero", *(f"{leg}{end}" for leg in LEGS for end in ("max", "min")))
    rho = np.array([spec.geometry.command(name) for name in names])
    apart = np.linalg.norm(machine.forward(rho) - bare.forward(rho), axis=-1)
    return compact(float(apart.max()) * 1e3, 2)


def _parameters(estimate: Estimate, figures: Mapping[str, Drawing]) -> Data:
    return {
        "rows": parameter_rows(estimate),
        "figure": whole(figures["parameters"]),
        "scaled": estimate.sigma_scale > 1,
        "scale": f"{estimate.sigma_scale:.2g}",
        "priors": estimate.problem.priors,
    }


def _fit(estimate: Estimate, figures: Mapping[str, Drawing]) -> Data:
    return {"rows": score_rows(estimate), "figure": whole(figures["residuals"])}


def readings_data(figures: Mapping[str, Drawing]) -> Data:
    """Readings and fit, for their section."""
    return {"panels": panels(figures["readings"])}


def _weak(estimate: Estimate, figures: Mapping[str, Drawing]) -> Data:
    return {
        "sentences": weak_sentences(estimate.weak),
        "figure": whole(figures["correlations"]),
        "count": len(estimate.names),
    }


_METHODS = {
    "nlp": "one nonlinear programme that carries the loop closures of every posture as constraints",
    "nested": "Newton steps on the parameters, every posture's loops closed at each step",
    "reduction": "the analytic reduction of the mechanism (three spheres)",
}
_SOURCES = {
    "declared": "as declared",
    "machine": "from the machine file, or the published repeatability where it has none",
    "repeats": "from the scatter of the repeats",
}


def method_data(estimate: Estimate, run: Run) -> Data:
    """How a fit was computed, for its section."""
    check, problem = estimate.check, estimate.problem
    return {
        "run": run,
        "machine": Path(problem.machine.spec.file).name or "the nominal Orthoglide",
        "method": _METHODS[estimate.method],
        "iterations": estimate.iterations,
        "optimality": compact(estimate.optimality, 1),
        "noise": compact(problem.noise.typical * 1e3, 2),
        "source": _SOURCES[problem.noise.source],
        "placement": compact(problem.machine.spec.dial.placement * 1e3, 2),
        "priors": problem.priors,
        "check": None
        if check is None
        else {
            "reduction": "less than 10⁻⁹"
            if check.reduction < 1e-12
            else compact(check.reduction * 1e3, 2),
            "linear": compact(check.linear * 1e3, 2),
            "size": compact(check.linear_size * 1e3, 2),
            "bound": compact(check.linear_bound * 1e3, 2),
            "second_order": check.second_order,
        },
    }
