"""Run folders: their files, how a stage writes and resumes them, and how later stages read them."""

from gsjax.runs.folder import (
    append_metrics,
    can_resume,
    claim_run,
    create,
    is_finished,
    is_run,
    latest_checkpoint,
    read_metrics,
    read_settings,
    read_similarity,
    reopen,
    require_free,
    require_scene,
    save_checkpoint,
    truncate_metrics,
    update_manifest,
)

__all__ = [
    "append_metrics",
    "claim_run",
    "create",
    "is_run",
    "is_finished",
    "can_resume",
    "latest_checkpoint",
    "read_metrics",
    "read_settings",
    "read_similarity",
    "reopen",
    "require_free",
    "require_scene",
    "save_checkpoint",
    "truncate_metrics",
    "update_manifest",
]
