# Every dependency from Debian: DOLFINx 0.9 with real PETSc, nothing from PyPI.
#   docker build -t cosserat-fx .
#   docker run --rm -v "$PWD/runs:/out" cosserat-fx                       the medium rough demo, into runs/
#   docker run --rm cosserat-fx python3 -m pytest                         the tests
#   docker run --rm -v "$PWD/runs:/out" cosserat-fx mpirun -n 2 cosserat-fx run demos/layer_very_rough.toml --out /out/layer_very_rough
FROM debian:trixie-slim

RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
      gcc \
      libc6-dev \
      openmpi-bin \
      python3 \
      python3-dev \
      python3-dolfinx \
      python3-dolfinx-real \
      python3-hypothesis \
      python3-matplotlib \
      python3-meshio \
      python3-mpi4py \
      python3-numba \
      python3-numpy \
      python3-petsc4py-real \
      python3-pip \
      python3-pydantic \
      python3-pytest \
      python3-pyvista \
      python3-rich \
      python3-scipy \
      python3-setuptools \
      python3-typer \
      python3-vtk9 \
      xauth \
      xvfb \
 && rm -rf /var/lib/apt/lists/*

# Small problems want ranks, not threads; the ranks of one container share memory; root and more ranks than cores are fine.
ENV OMP_NUM_THREADS=1 \
    OMPI_ALLOW_RUN_AS_ROOT=1 \
    OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 \
    OMPI_MCA_btl=self,sm \
    PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe

# Compiled forms and kernels, writable for any user.
ENV XDG_CACHE_HOME=/var/cache/cosserat_fx \
    NUMBA_CACHE_DIR=/var/cache/cosserat_fx/numba \
    MPLCONFIGDIR=/var/cache/cosserat_fx/matplotlib
RUN install --directory --mode=1777 /var/cache/cosserat_fx /out

WORKDIR /opt/cosserat_fx
COPY . .
RUN python3 -m pip install --no-deps --no-build-isolation --no-index --break-system-packages --root-user-action=ignore --editable .
# Compiled once here, so that no run in a container starts by compiling.
RUN cosserat-fx check demos/layer_medium_rough.toml && chmod -R a+rwX /var/cache/cosserat_fx

CMD ["cosserat-fx", "run", "demos/layer_medium_rough.toml", "--out", "/out/layer_medium_rough", "--overwrite"]
