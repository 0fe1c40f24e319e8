"""Films of recordings in three dimensions, drawn without a screen and written as MP4 or GIF.

`film` takes the frames of a recording, `picture` draws each of them by `raster` from the triangles of
its solids as a camera sees them, `overlays` adds signs and texts, `codecs` writes the file. All of it is
private: the command `usarmjx film` is for users. Begin with `film.save_film`.
"""
