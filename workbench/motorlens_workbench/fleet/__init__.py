"""Many motors of one make: what they have in common, which are odd, what changed. In the order in which it goes:

`manifest` says which recordings there are; `work` fits each, and `summary` makes a parabola of it; `store` keeps results by
what they follow from. `directions` puts parabolas on one scale, `levels` is the mixed model in closed form, `odd` says who
differs, `population` is all of that of some recordings; `study` goes from the first recording to the make. `history` is one
motor over its dates, `diagnosis` what is missing in one. The page is `report.fleet`, the command `commands.fleet`.
"""
