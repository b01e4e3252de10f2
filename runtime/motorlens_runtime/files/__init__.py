"""Recorded data: headings and units, CSV and Parquet, and the estimator over whole files."""
