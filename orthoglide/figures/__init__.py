"""Figures as SVG.

Texts remain texts and colours are named (see `style`), so that the page can apply its own font
and its light and dark colours. Equal results give equal bytes.
"""
