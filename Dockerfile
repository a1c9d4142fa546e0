# docker build --tag rsmcm .
# docker run --rm --read-only --tmpfs /tmp --user "$(id -u):$(id -g)" --volume "$PWD:/data" rsmcm \
#   batch background films --out results
# docs/running.md says more, and what of this was tested.

FROM python:3.13-slim AS build
COPY . /source
RUN python -m venv /opt/rsmcm \
  && /opt/rsmcm/bin/pip install --no-cache-dir --constraint /source/constraints.txt /source
# Each command runs once, so that its compiled loops are kept beside the modules, where nobody can change them.
WORKDIR /warm
RUN export PATH=/opt/rsmcm/bin:$PATH \
  && rsmcm demo \
  && rsmcm structure results/demo/cylinder.npz --out results/shape \
  && rsmcm face results/demo/face/input --out results/face --landmarks results/demo/face/landmarks.npy \
  && rsmcm body results/demo/body/input --out results/body --head 354,74,58,82

FROM python:3.13-slim
COPY --from=build /opt/rsmcm /opt/rsmcm
# numpy's and OpenCV's own temporary files, and matplotlib's list of fonts, go to /tmp
ENV PATH=/opt/rsmcm/bin:$PATH MPLCONFIGDIR=/tmp
USER 1000:1000
WORKDIR /data
ENTRYPOINT ["rsmcm"]
CMD ["--help"]
