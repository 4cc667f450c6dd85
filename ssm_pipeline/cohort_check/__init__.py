"""Before the hours: which cases of a cohort do not look like the others.

A fingerprint of each mesh (size, compactness, Laplacian spectrum), its rigid fit to the cohort's
most typical cases, as it lies, turned and mirrored, and what is striking of them, in words.
"""
