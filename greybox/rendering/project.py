"""The list of models."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.rendering.registry import renders

if TYPE_CHECKING:
    from greybox.project import ModelListing


@renders("ModelListing")
def model_listing(listing: ModelListing) -> str:
    """Three lines a model: name and description, its signals, its file."""
    lines = []
    for entry in listing.models:
        model = entry.model
        states = ", ".join(s.name for s in model.all_states)
        inputs = ", ".join(i.name for i in model.inputs) or "none"
        outputs = ", ".join(y.name for y in model.outputs)
        lines += [
            f"{entry.name}: {model.description}" if model.description else entry.name,
            f"    states {states}; inputs {inputs}; outputs {outputs}",
            f"    {entry.where}",
        ]
    return "\n".join(lines)
