"""How good the views are: metrics with their settings, tables and figures.

The names of the metrics stand here, so that the command line can list them without importing torch.
"""

METRICS = ("psnr", "ssim", "ssim_svs", "lpips")
LPIPS_NETS = ("alex", "vgg", "squeeze")
SPLITS = ("test", "train")
