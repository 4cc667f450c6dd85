"""Folders of masks or surfaces, and LUNA16, as cohorts of cases."""
