"""What a discovery gives back, as a value, as JSON and in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.result import Fit, layout, plain


@dataclass(frozen=True)
class Gap:
    """Rms free-run misfit of one output on the validation records, before and after, beside the noise floor, in ``unit``."""

    before: float
    after: float
    floor: float
    unit: str

    @property
    def closed(self) -> float:
        """Share of the gap to the floor that was closed."""
        return (self.before - self.after) / max(self.before - self.floor, 1e-12 * self.before)


@dataclass(frozen=True)
class Rank:
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
    ``story`` one paragraph; ``notes`` what to know before believing it.
    """

    verdict: str
    base: Fit
    best: Fit
    alternatives: Sequence[tuple[str, ...]]
    gap: Mapping[str, Gap]
    ranking: Sequence[Rank]
    sites: Sequence[str]
    story: str
    notes: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Name, site and constants of each effect in the best model; none if the plain model is complete."""
        found = []
        for b in self.best.model.bound_effects:
            constants = {}
            for own, there in b.own.items():
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
            "verdict": self.verdict, "effects": self.effects, "alternatives": self.alternatives, "sites": self.sites,
            "parameters": self.best.parameters, "gap": self.gap, "ranking": self.ranking, "story": self.story,
            "notes": self.notes, "seconds": self.seconds, "model": self.best.model.name, "equations": self.best.equations,
            "noise": self.best.noise, "noise_source": self.best.noise_source, "versions": self.best.versions,
        }  # fmt: skip
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(layout(plain(data)) + "\n", encoding="utf-8")
        return target

    def __str__(self) -> str:
        lines = [self.story, ""]
        for effect in self.effects:
            values = ", ".join(_constant(name, c) for name, c in effect["parameters"].items())
            lines.append(f"  {effect['name']} -> {effect['site']}: {values}")
        for output, gap in self.gap.items():
            lines.append(
                f"  {output}: rms misfit on the validation records {gap.before:.4g} -> {gap.after:.4g} {gap.unit} (noise {gap.floor:.4g})"
            )
        if self.ranking:
            lines += ["", "  candidate                                misfit/noise   behind the best"]
            lines += [f"  {' + '.join(r.effects):40s} {r.misfit:12.4g}   {r.behind:15.4g}" for r in self.ranking[:10]]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines)


def _constant(name: str, c: Mapping[str, Any]) -> str:
    std = "" if c["std"] is None else f" +- {c['std']:.2g}"
    return f"{name} = {c['value']:.5g}{std} {c['unit']}".rstrip()
