"""The workbench as a page in the browser: compare, diagnose, add, compare again."""
