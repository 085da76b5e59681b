"""What the catalogue does not hold, written down as an equation: terms that a site may have, tried in the model like effects."""

from greybox.discovery.laws.policy import LawPolicy
from greybox.discovery.laws.search import Law, LawSearch, search_laws
from greybox.discovery.laws.terms import LawTerm, list_terms

__all__ = ["Law", "LawPolicy", "LawSearch", "LawTerm", "list_terms", "search_laws"]
