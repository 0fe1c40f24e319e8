"""Common modules, which use no other package.

The exception tree (`errors`), the one registry (`registry`), types of arrays (`arrays`), rotations of JAX
arrays (`rotations`), how sure results are (`estimates`), the conversion between USARSim's axes and MuJoCo's
(`transforms`), and the guard against a deadlock of JAX's CPU backend (`threads`). `errors`, `registry` and
`transforms` import no JAX, as the server's protocol does without. Begin with `errors`.
"""
