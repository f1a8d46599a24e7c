"""Export a record as model files of other engines: one module each, in `registry.FORMATS`.

An engine's file is a module with the names of `registry.ExportFormat`: `NAME`, `SUFFIX`, `STEP_S`,
`LIBRARY`, `ball_text`, `payload_text`; `companion` where one file is not enough; and `dropped`
where Python can run the engine, for the check that drops the ball again.
"""
