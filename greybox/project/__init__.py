"""Where models come from: the project around the working folder, files given by path, and what is shipped."""

from greybox.project.find import Found, Listing, listing, resolve, shipped
from greybox.project.place import project_root, template_root
from greybox.project.template import init

__all__ = ["Found", "Listing", "init", "listing", "project_root", "resolve", "shipped", "template_root"]
