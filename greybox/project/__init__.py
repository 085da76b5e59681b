"""Where models come from: the project around the working folder, files given by path, and what is shipped."""

from greybox.project.find import ModelEntry, ModelListing, find_model, find_shipped_model, is_model_path, list_models
from greybox.project.folders import project_root, template_root
from greybox.project.template import plant_names, write_project

__all__ = [
    "ModelEntry",
    "ModelListing",
    "find_model",
    "find_shipped_model",
    "is_model_path",
    "list_models",
    "plant_names",
    "project_root",
    "template_root",
    "write_project",
]
