"""uPlot, the plotting library of the pages: see README.md."""
