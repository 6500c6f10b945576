"""Keys of recipes that earlier releases had, and what replaces each of them."""

from collections.abc import Mapping

#: Key, without the indices of lists -> what to do now.
FORMER_KEYS: Mapping[str, str] = {
    "model.max_depth_m": "it is model.config.max_depth_m now",
    "model.canonical_focal_px": "it is model.config.canonical_focal_px now",
    "model.boundary_gating": "it is model.config.boundary_gating now",
    "model.sparse_depth_gain": "it is model.config.sparse_depth_gain now",
    "loss.boundary_beta": "beta is always computed over the batch",
    "loss.side_boundary_weight": "nothing replaces it; the fused boundary is supervised",
    "loss.depth_l1": "the weights are the paper's; see loss.depth_form for another loss",
    "loss.depth_l2": "the weights are the paper's; see loss.depth_form for another loss",
    "loss.depth_ssim": "the weights are the paper's; see loss.depth_form for another loss",
    "loss.joint_depth_scale": "the depth of Eq. 11 is normalised",
    "data.frequency_samples": "class frequencies are always counted in 400 frames",
    "data.augment.scale_depth": "set model.config.canonical_focal_px, by which depth is scaled",
    "data.augment.recorded_share": "it is fixed at 0.3 to 0.8",
    "data.augment.misalignment_deg": "it is fixed at 0.5; see data.augment.lidar_misaligned",
    "data.augment.misalignment_m": "it is fixed at 0.05; see data.augment.lidar_misaligned",
    "data.augment.dropout_share": "it is fixed at 0.05 to 0.3; see data.augment.lidar_dropout",
    "schedule.final_ratio": "the rate ends at 0; see schedule.shape",
    "loop.channels_last": "tensors are always channels-last",
    "loop.compile": "nothing replaces it; torch.compile did not help",
    "data.paste_classes": "nothing replaces it; things of other frames are not pasted",
    "data.source.things": "nothing replaces it; things of other frames are not pasted",
    "data.augment.paste": "nothing replaces it; things of other frames are not pasted",
    "data.augment.style": "nothing replaces it; frames keep their own colours",
    "data.augment.lidar_solid_state": "nothing replaces it; see data.augment.lidar_random",
    "loop.logit_adjustment": "it is release.logit_adjustment now",
    "loop.logit_offsets": "it is release.logit_offsets now",
    "loop.trained_share": "it is release.trained_share now",
}
