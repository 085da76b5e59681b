"""From findings, checks and results to English: every sentence that the program says about a result is in this package.

A module of this package serves one package of the library (``rendering/estimation.py`` serves ``greybox.estimation``). It holds

- ``register({code: template})``: one template for each code of findings, checks and other enumerations. A template is a format string
  over the finding's values and ``subject`` (``"The residual in {subject} is {ratio:.3g} times the sensor noise"``), or a function from
  the finding to its sentence where a list or a plural has to be written.
- ``@renders("Fit")``: the function that writes a result of the class of that name as plain text for ``print(result)``.

A writer is found by the name of the class, so a module needs a result class for type checking only.
"""

from greybox.rendering.registry import register, renders, sentence, sentences, templates, text

__all__ = ["register", "renders", "sentence", "sentences", "templates", "text"]
