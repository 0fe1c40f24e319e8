"""Films of recordings in three dimensions: `film` is the whole way, from `raster` and `picture` to `codecs`."""
