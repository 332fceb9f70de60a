# docker build -t zipf .
# docker run --rm -v "$PWD/runs:/work/runs" zipf train experiment=demo
#
# For CPUs. For a GPU: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu128, and docker run --gpus all.
FROM python:3.12-slim

ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY . /zipf
RUN pip install --no-cache-dir --extra-index-url "$TORCH_INDEX" --constraint /zipf/constraints.txt "/zipf[video]"
WORKDIR /work
ENTRYPOINT ["zipf"]
