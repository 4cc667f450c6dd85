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
# PyTorch without CUDA: a fifth of the size. For a GPU, leave the index out.
RUN pip install --no-cache-dir -c constraints.txt \
        --extra-index-url https://download.pytorch.org/whl/cpu .
WORKDIR /work
ENV HOME=/tmp OMP_NUM_THREADS=1
ENTRYPOINT ["workflow"]
CMD ["--help"]
