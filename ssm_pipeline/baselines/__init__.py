"""The rivals of the method: plain registration of a template to each case, and S3M.

Each rival fits a template to a case, from the same rigid start pose as every row of a table. The
template's vertices are then projected onto the nearest triangles of the case, as for the method
itself.
"""
