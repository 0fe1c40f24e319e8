# Without this file `from flax import struct` would find our types or flax's own, whichever pyright met first.
