"""What a discovery gives back, as a value, as JSON and in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.holdout_error import HoldoutError
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.refinement import Refinement
from greybox.discovery.shape_correction import is_shape_correction
from greybox.discovery.surrogate import Surrogate
from greybox.result import Fit, format_json, to_json_data


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate as it did on the estimation records: misfit over noise, and how far its criterion is above the best."""

    effects: tuple[str, ...]
    misfit: float
    behind: float


@dataclass(frozen=True)
class Discovery:
    """The answer to "what is missing?".

    ``verdict``: ``complete`` (nothing is missing beyond the noise), ``named``, ``ambiguous`` (``alternatives`` explain the records
    as well), or ``unknown`` (something is missing that no effect of the catalogue explains; ``best`` is the nearest look-alike).
    ``base`` and ``best`` are fits of the plain and of the extended model; ``gap`` by output; ``ranking`` of the candidates;
    ``look``: where, when and in which region the plain model falls short; ``story`` one paragraph; ``notes`` what to know before
    believing it; ``missing``: for each effect its signal as the data and as the extended model have it; ``stand_in``: a smooth curve
    or a tone in the place of an unknown effect; ``deeper``: what `refine` found beyond, where it was asked;
    ``next_steps``: what to do about something unknown, or before
    believing that nothing is missing.
    """

    verdict: str
    base: Fit
    best: Fit
    alternatives: Sequence[tuple[str, ...]]
    gap: Mapping[str, HoldoutError]
    ranking: Sequence[RankedCandidate]
    look: ResidualLocalisation
    story: str
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    missing: tuple[EffectSignal, ...] = ()
    surrogate: Surrogate | None = None
    refinement: Refinement | None = None
    next_steps: tuple[str, ...] = ()

    @property
    def sites(self) -> tuple[str, ...]:
        """Where the plain model falls short: the likeliest site with those that the sensors cannot tell from it."""
        return self.look.where

    @property
    def extended(self) -> Fit:
        """The fit to go on with: that with the named effects, and what was found beyond them; the plain one where it is complete; with
        the stand-in where it is unknown."""
        if self.refinement is not None and self.refinement.steps:
            return self.refinement.fit
        return self.surrogate.fit if self.verdict == "unknown" and self.surrogate is not None else self.best

    @property
    def form(self) -> tuple[str, ...]:
        """Refinements in the best model: second branches, or a curve, where the form of an effect is not quite the catalogue's."""
        return tuple(e.name for e in self.best.model.effects if is_shape_correction(e.name))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Name, site and constants of each effect in the best model; none if the plain model is complete."""
        found = []
        for b in self.best.model.bound_effects:
            if is_shape_correction(b.effect.name):
                continue
            constants = {}
            for own, there in b.model_names.items():
                estimate = self.best.parameters.get(there)
                if estimate is not None:
                    constants[own] = {
                        "value": estimate.value, "std": estimate.std, "unit": estimate.unit, "interval": estimate.interval,
                    }  # fmt: skip
            found.append({"name": b.effect.name, "site": b.site, "parameters": constants})
        return found

    def save(self, path: str | Path) -> Path:
        """Write ``discovery.json``."""
        data = {
            "verdict": self.verdict, "effects": self.effects, "form": self.form, "alternatives": self.alternatives, "sites": self._sites(),
            "when": self.look.windows, "regions": self.look.dependences, "stand_in": self._stand_in(),
            "further": self._further(),
            "parameters": self.best.parameters, "gap": self.gap, "ranking": self.ranking, "story": self.story,
            "next_steps": self.next_steps, "notes": self.notes, "seconds": self.seconds,
            "model": self.best.model.name, "equations": self.best.provenance.equations,
            "noise": self.best.noise.std, "noise_source": self.best.noise.source, "versions": self.best.provenance.versions,
        }  # fmt: skip
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(format_json(to_json_data(data)) + "\n", encoding="utf-8")
        return target

    def _sites(self) -> list[dict[str, Any]]:
        """Ranked sites, each with the number of the set that the sensors cannot separate it from (0: the likeliest)."""
        sets = {name: k for k, group in enumerate(self.look.sets) for name in group}
        return [
            {"name": s.name, "kind": s.kind, "gain": s.gain, "set": sets[str(s)], "size": s.size, "unit": s.unit}
            for s in self.look.sites
        ]

    def _further(self) -> dict[str, Any] | None:
        if self.refinement is None:
            return None
        fit = self.refinement.fit
        return {
            "steps": self.refinement.steps, "effects": [e.name for e in fit.model.effects], "parameters": fit.parameters,
            "misfit": fit.misfit, "validation": fit.validation.misfit,
        }  # fmt: skip

    def _stand_in(self) -> dict[str, Any] | None:
        found = self.surrogate
        if found is None:
            return None
        return {
            "site": found.site, "variable": found.variable, "variable_unit": found.variable_unit, "unit": found.unit,
            "closed": found.explained_fraction, "gap": found.gap, "values": found.values, "curve": found.curve,
            "shape": found.shape, "period": found.region.period, "tone": found.tone,
        }  # fmt: skip

    def __str__(self) -> str:
        lines = [self.story, *([self.refinement.story] if self.refinement is not None else []), ""]
        if self.look.missing:
            lines += [f"  the plain model: {line}" for line in str(self.look).splitlines()]
        for effect in self.effects:
            values = ", ".join(_constant(name, c) for name, c in effect["parameters"].items())
            looks = "the look-alike " if self.verdict == "unknown" else ""
            lines.append(f"  {looks}{effect['name']} -> {effect['site']}: {values}")
        for output, gap in self.gap.items():
            lines.append(f"  {output}: rms misfit on the validation records {gap}")
        if self.refinement is not None and self.refinement.steps:
            after = self.refinement.fit.validation.misfit.items()
            lines += [f"  {o}: {m.rmse:.4g} {m.unit}".rstrip() + " with the further effects" for o, m in after]
        if self.surrogate is not None:
            lines.append(f"  stand-in: {self.surrogate}")
        if self.ranking:
            lines += ["", "  candidate                                misfit/noise   behind the best"]
            lines += [f"  {' + '.join(r.effects):40s} {r.misfit:12.4g}   {r.behind:15.4g}" for r in self.ranking[:10]]
        lines += [f"next: {step}" for step in self.next_steps]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines)


def _constant(name: str, c: Mapping[str, Any]) -> str:
    std = "" if c["std"] is None else f" +- {c['std']:.2g}"
    return f"{name} = {c['value']:.5g}{std} {c['unit']}".rstrip()
