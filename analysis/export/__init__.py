"""Export a record as model files of other engines: one module each, in `registry.FORMATS`.

An engine's module has the names of `registry.ExportFormat`, and fills its `templates`;
`companion` where one file is not enough, and `dropped` where Python can run the engine, for the
check that drops the ball again.
"""
