# CPU image that runs the demo: docker build -t torchweather . && docker run -v "$PWD/out:/out" torchweather
FROM python:3.11-slim
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir --extra-index-url https://download.pytorch.org/whl/cpu -c constraints.txt .
WORKDIR /out
ENTRYPOINT ["torchweather"]
CMD ["demo"]
