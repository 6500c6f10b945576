"""Keys of recipes that earlier releases had, and what replaces each of them."""

from collections.abc import Mapping

#: Key, without the indices of lists -> what became of it: "renamed: KEY", or "removed: " and why.
FORMER_KEYS: Mapping[str, str] = {
    "model.max_depth_m": "renamed: model.config.max_depth_m",
    "model.canonical_focal_px": "renamed: model.config.canonical_focal_px",
    "model.boundary_gating": "renamed: model.config.boundary_gating",
    "model.sparse_depth_gain": "renamed: model.config.sparse_depth_gain",
    "loss.boundary_beta": "removed: beta is counted over the batch",
    "loss.side_boundary_weight": "removed: the fused boundary is supervised",
    "loss.depth_l1": "removed: the weights are the paper's; see loss.depth_form for another loss",
    "loss.depth_l2": "removed: the weights are the paper's; see loss.depth_form for another loss",
    "loss.depth_ssim": "removed: the weights are the paper's; see loss.depth_form for another loss",
    "loss.joint_depth_scale": "removed: the depth of Eq. 11 is normalised",
    "data.frequency_samples": "removed: class frequencies are counted in 400 frames",
    "data.augment.scale_depth": "removed: set model.config.canonical_focal_px, which scales depth",
    "data.augment.recorded_share": "removed: it is 0.3 to 0.8",
    "data.augment.misalignment_deg": "removed: it is 0.5; see data.augment.lidar_misaligned",
    "data.augment.misalignment_m": "removed: it is 0.05; see data.augment.lidar_misaligned",
    "data.augment.dropout_share": "removed: it is 0.05 to 0.3; see data.augment.lidar_dropout",
    "schedule.final_ratio": "removed: the rate ends at 0; see schedule.shape",
    "loop.channels_last": "removed: tensors always are",
    "loop.compile": "removed: torch.compile did not help",
    "data.paste_classes": "removed: things of other frames are not pasted",
    "data.source.things": "removed: things of other frames are not pasted",
    "data.augment.paste": "removed: things of other frames are not pasted",
    "data.augment.style": "removed: frames keep their own colours",
    "data.augment.lidar_solid_state": "removed: see data.augment.lidar_random",
    "loop.logit_adjustment": "renamed: release.logit_adjustment",
    "loop.logit_offsets": "renamed: release.logit_offsets",
    "loop.trained_share": "renamed: release.trained_share",
}
