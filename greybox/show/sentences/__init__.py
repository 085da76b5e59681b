"""From findings, checks and results to English: every sentence that the program says about a result is in this package.

A module of this package serves one package of the library (``sentences/estimation.py`` serves ``greybox.estimation``). It holds

- ``register({code: template})``: one template for each code of findings, checks and other enumerations. A template is a format string
  over the finding's values and ``subject`` (``"The residual in {subject} is {ratio:.3g} times the sensor noise"``), or a function from
  the finding to its sentence where a list or a plural has to be written.
- ``@renders("Profile")``: the function that writes a value of the class of that name, as a text or as blocks (`greybox.base.document`). A
  result that has a page is described in `greybox.show.documents`.

One style holds for all of them:

- A finding or a check is one clause that follows ``note:``, ``warning:``, ``error:``, ``next:``, ``remedy:`` or the name of a record:
  a small first letter, no full stop at its end. A cause follows a colon; a remedy is an imperative and follows a semicolon or a colon:
  ``output 'x' is constant at 3e-06: a constant signal carries no information; leave it out``.
- An answer is a paragraph of full sentences with capitals and full stops: the conclusion of a discovery, the verdict of a comparison,
  the text of a page, the caption of a figure. Pages write findings as sentences (`greybox.show.sentences.wording.as_sentence`).
- Headings, panel titles, table heads and table cells have no full stop.
- Subject first, then the number with its unit, then what it means, then the remedy. Present tense, active voice, no figure of speech.
- The words are those of ``docs/glossary.md``: a *parameter* is fitted; the *residual* is measured minus simulated; *estimation records*
  and *validation records*; *initial state*; *simulation error* and *prediction error*; a *gap* is a stretch of time without rows.

A writer is found by the name of the class, so a module needs a result class for type checking only.
"""

from greybox.show.sentences.registry import register, renders, sentence, sentences, templates

__all__ = ["register", "renders", "sentence", "sentences", "templates"]
