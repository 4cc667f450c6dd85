"""What people look at: the report page of a study, of new patients, of a comparison, and figures.

`page`, `fit_page` and `compare_page` each write one HTML file that works offline; `template` fills
the templates of `viewer/`, whose scripts (`viewer/src`, bundled into `viewer.js`) draw surfaces and
charts in the browser. `content` says what a report shows; nothing is computed again here.
"""
