"""A shape model and a patient it was not built from: pose, scores, reconstruction, and whether the
patient is of the model's kind at all.

`pose_search` and `model_fit` lay the model on a surface; `typicality` judges the fit by those of
the model's own cases (`cross_validation`); `completion` says how uncertain each vertex is, where
the surface is only a part too; `patient` does all of that in order.
"""
