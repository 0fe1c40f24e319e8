"""`usarmjx bench report`: the tables and figures of docs/evidence/speed.md, from benchmarks/results.

`records` reads them, also those of older versions; `tables` and `peer_tables` make Markdown, `laws` cost over
size, `figures` draws, `page` puts it between the markers of a page and leaves the text around them alone.
Begin with `page`.
"""
