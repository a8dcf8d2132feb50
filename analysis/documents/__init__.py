"""Tables, pages, drawings and files: the form of all that is shown, and nothing of what it means.

Sections with tables, records and figures come in; text, Markdown, CSV, LaTeX, SVG, PNG and one HTML file come out, and
are written so that no file that is not ours is ever replaced. It is the lowest room and imports no other.
"""
