"""Shape against covariates: is there a difference, where, how large, and could this cohort show it?

`covariates` checks a table against the cases and makes the design, `permutation` tests,
`effects` says how large, `power` what the number of cases can carry, `compare` does all in order.
Arrays in memory; tables and pages are written elsewhere.
"""
