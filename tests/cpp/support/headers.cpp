// A source for the precompiled headers of the tests, which need one.
