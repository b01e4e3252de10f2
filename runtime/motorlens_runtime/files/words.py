"""Quantities that are words instead of numbers with a unit; each counts from 0, and no word is used twice but for that.

Apart from `columns`, because the overview of all commands shows the words and must not wait for numpy.
"""

WORDS = {"terminal": ("driven", "open", "shorted", "current"), "shaft": ("free", "locked", "turned")}
