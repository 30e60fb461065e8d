"""Configuration of Sphinx; ``build.py`` beside it says what the pages are."""

from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

import orthoglide

HERE = Path(__file__).resolve().parent

project = "orthoglide"
release = orthoglide.__version__
language = "en"
root_doc = "index"
extensions = ["myst_parser", "sphinx.ext.autodoc"]

myst_heading_anchors = 3
default_role = "code"
highlight_language = "none"

autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True

# A name in a docstring that leads nowhere is a warning, and warnings are errors; types of
# annotations are not all public.
nitpicky = True
nitpick_ignore_regex = [("py:class", ".*")]

html_theme = "furo"
html_title = "orthoglide"
html_static_path = [str(HERE / "style.css")]
html_css_files = ["style.css"]
html_copy_source = False
html_show_copyright = False
html_theme_options = {"top_of_page_buttons": []}


def setup(app: Sphinx) -> None:
    """CSV, of which Pygments knows nothing, stands as it is; docstrings have sections."""
    app.add_lexer("csv", TextLexer)
    app.connect("autodoc-process-docstring", sections)


def sections(app: Sphinx, what: str, name: str, public: object, _: object, text: list[str]) -> None:
    """Args, Returns, Raises and Attributes as field lists.

    Not by the extension, which takes what stands before the colon of a property for its type.
    """
    text[:] = GoogleDocstring(text, Config(napoleon_use_ivar=True), app, "", name, public).lines()
