"""The stages of a study, one module each; `list.py` is the pipeline.

A stage reads the files of the stages before it, calls one room, and writes into
`runs/<study>/<stage>/`.
"""
