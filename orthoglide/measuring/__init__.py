"""At the machine: the sheet that is carried there."""

from orthoglide.measuring.page import sheet_page

__all__ = ["sheet_page"]
