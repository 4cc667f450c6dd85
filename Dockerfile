# docker build -t ssm-pipeline .
# docker run --rm -v "$PWD/runs:/work/runs" ssm-pipeline run luna16
# docker run --rm -v "$PWD/runs:/work/runs" -v /where/luna16/is:/data:ro \
#     ssm-pipeline run luna16 --data /data
FROM python:3.12-slim-bookworm
RUN apt-get update -qq \
    && apt-get install -y -qq --no-install-recommends libgl1 libopengl0 libegl1 libosmesa6 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY data_prep data_prep
COPY ssm_pipeline ssm_pipeline
COPY workflows workflows
# PyTorch's build with CUDA is five times larger than the one for CPUs. For the latter, pass the index
# that PyTorch's installation page names: docker build --build-arg TORCH_INDEX=…
ARG TORCH_INDEX=
RUN pip install --no-cache-dir -c constraints.txt ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} .
WORKDIR /work
ENV HOME=/tmp OMP_NUM_THREADS=1
ENTRYPOINT ["workflow"]
CMD ["--help"]
