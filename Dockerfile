# ROS 2 Jazzy with CableSense built in a workspace: the lines of docs/development.md, "With ROS 2 Jazzy installed".
#
#     docker build --target robot --tag cablesense:robot .      # the estimator, the CAN driver, the commissioner
#     docker build --tag cablesense .                           # all nodes, the page, the diagnosis
#     docker run --rm --net host --ipc host cablesense ros2 launch cablesense_ros demo.launch.py page:=true

FROM ros:jazzy AS workspace
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /workspace
RUN python3 -m venv --system-site-packages venv && touch venv/COLCON_IGNORE
ENV VIRTUAL_ENV=/workspace/venv PATH=/workspace/venv/bin:$PATH
COPY . src/cablesense
COPY docker/entrypoint.sh /cablesense_entrypoint.sh
ENTRYPOINT ["/cablesense_entrypoint.sh"]

FROM workspace AS robot
ENV CABLESENSE_ROBOT=1
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && python3 -m rosdep2 install -y --from-paths src --ignore-src --as-root pip:no \
    && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir 'numpy<2' 'pydantic>=2' lazy-loader onnx
RUN . /opt/ros/jazzy/setup.bash && python3 -m colcon build --base-paths src src/*/cablesense_msgs
CMD ["ros2", "launch", "cablesense_ros", "estimator.launch.py", "source:=can"]

FROM workspace AS full
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && python3 -m rosdep2 install -y --from-paths src --ignore-src --as-root pip:no \
    && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir 'numpy<2' 'pydantic>=2' lazy-loader lz4 mcap msgspec onnx trimesh viser zstandard
RUN . /opt/ros/jazzy/setup.bash && python3 -m colcon build --base-paths src src/*/cablesense_msgs
CMD ["ros2", "launch", "cablesense_ros", "demo.launch.py", "page:=true"]
