"""Reconstructions of sample buffers that others have published: the systems that spreadlets are compared with.

SLR is *Layered Light Field Reconstruction for Defocus Blur* (Vaidyanathan et al. 2015), LRDM *Layered Reconstruction
for Defocus and Motion Blur* (Munkberg et al. 2014) with the practical improvements of Hasselgren et al. (2015), TLFR is
*Temporal Light Field Reconstruction for Rendering Distribution Effects* (Lehtinen et al. 2011), see docs/tlfr.md.
Nothing outside this package imports it but the public function that is asked for one of its methods. Patents have been
published on layered reconstruction (US 9,483,869; 9,672,657; 9,298,006): check before shipping it.

How the parts fit together, in the order of the work:

1. `samples.Samples.from_buffer` flattens a `SampleBuffer`: one row per sample, sorted by the pixel that it lies in,
   with its signed CoC ``coc``. In this package a sample that lies at ``place`` is seen from the lens's centre at
   ``place - coc * lens`` (SLR Eq. 1 with the lens coordinate's sign turned).
2. `partitions.Partitioning` divides the axis of CoC into partitions, near to far; ``Partitioning.of`` gives the
   partition of every sample. Samples that met nothing are in an extra, last one (`partitions.BEHIND`).
3. `tiles.Tiling` divides the image into tiles, each with a border of samples that its filters may reach.
4. `layers.find_layers` gives the layers of every tile: the partitions that its samples are in, merged or not, as a
   table ``slot[tile, partition]`` of layer numbers, and the range of CoC of each layer.
5. A `method.Method` sets up one filter per layer, in vectorised NumPy over all layers of all tiles, and fills an image
   with compiled kernels that hold no lock. `method.run` calls them for every tile, in threads; tiles write different
   pixels, so the image is the same for any number of threads.
   `lrdm.Lrdm` works in blocks of tiles instead, step by step: set-up (with statistics and layers of its own, which know
   motion), reprojection and the first pass of the screen filters in `_lrdm_kernels` and `_gauss_kernels`, then the
   second pass and compositing.
   `tlfr.Tlfr` needs no partitions: it moves samples to many views of each pixel, and finds what hides what there; its
   layers, of what views have seen, are only filtered on the screen.
6. `reconstruct.METHODS` names the methods; `reconstruct.reconstruct` is what the public function calls.

What the kernels of methods share is in `_tile_kernels`: `blur` (the screen filter, the same along x and y), `composite`
(normalisation, and SLR Eq. 35 front to back) and `share_out` (after the last layer).
"""
