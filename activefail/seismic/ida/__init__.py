"""Incremental dynamic analysis: at which intensity of each record a bearing fails, and the fragility that follows."""
