"""Configuration of Sphinx; ``build.py`` beside it says what the pages are."""

from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

import orthoglide

HERE = Path(__file__).resolve().parent

project = "orthoglide"
release = orthoglide.__version__
language = "en"
root_doc = "index"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]

myst_heading_anchors = 3
default_role = "code"
highlight_language = "none"

autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_use_ivar = True
napoleon_use_rtype = False

nitpicky = True  # a name in a docstring that leads nowhere is a warning, and warnings are errors

html_theme = "furo"
html_title = "orthoglide"
html_static_path = [str(HERE / "style.css")]
html_css_files = ["style.css"]
html_copy_source = False
html_show_copyright = False
html_theme_options = {"top_of_page_buttons": []}


def setup(app: Sphinx) -> None:
    """CSV, of which Pygments knows nothing, stands as it is."""
    app.add_lexer("csv", TextLexer)
