"""Route networks and missions of the DARPA Urban Challenge (manual 3.2.1.2), for cars.

`network` has the data and what may be wrong with it, `rndf` and `mdf` text to data and back, `geodesy`
latitudes to metres, `shapes` the paint and kerbs that make an arena of it. Begin with `rndf.read_rndf`.
Reading and writing are inverses: what a file says is kept, in its units (feet, miles per hour), until
`shapes`.
"""
