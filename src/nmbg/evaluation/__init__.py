"""How good the views are: metrics with their settings, tables, figures and pages.

The names of the metrics stand here, so that the command line can list them without importing torch.
"""

METRICS = ("psnr", "ssim", "ssim_svs", "lpips")
LPIPS_NETS = ("alex", "vgg", "squeeze")
SPLITS = ("test", "train")


def higher_is_better(metric: str) -> bool:
    """Whether more of a metric, named as in metrics.json, is better."""
    return not metric.startswith("lpips")
