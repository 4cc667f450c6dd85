"""What the method is compared with: plain registration of a template to each case, and S3M.

Each rival lays a template on a case, from the rigid start that every row of a table has; the
template's vertices are then carried to the nearest points of the case's triangles, as the
method's own are.
"""
