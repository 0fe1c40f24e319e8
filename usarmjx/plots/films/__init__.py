"""Films of recordings in three dimensions: `film` joins `picture`, `overlays` and `codecs`."""
