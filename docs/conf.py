# SPDX-License-Identifier: Apache-2.0
"""The documentation as web pages: the Markdown of this folder, and the reference from docstrings (CONTRIBUTING.md)."""

from machine_tool_calibration import __version__

project = "machine_tool_calibration"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"npt.ArrayLike": "npt.ArrayLike"}
default_role = "code"
html_theme = "alabaster"
html_show_copyright = False
html_theme_options = {
    "description": "Errors of machine tools, each with its uncertainty",
    "page_width": "70rem",
    "fixed_sidebar": True,
}
html_sidebars = {"**": ["about.html", "searchfield.html", "navigation.html"]}
