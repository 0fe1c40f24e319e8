"""Engine `c`: C MuJoCo, which starts at once and is the oracle for the others."""
