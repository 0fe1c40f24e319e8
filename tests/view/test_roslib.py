"""The stock browser library of ROS and its 3-D viewer, roslib and ros3d, at a served world's rosbridge.

Both come from npm: `npm install --no-save roslib@1.4.1 ros3d@1.1.0` in the checkout. Without them, or without
Chromium, the test is skipped.
"""

import io
import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from PIL import Image

import dev
from tests.arenas import FLAT
from tests.server.rosbridge.test_net import serving_ros
from usarmjx.server.worlds.dynamic_world import DynamicWorld

SCRIPTS = [dev.ROOT / "node_modules" / name / "build" / f"{name}.js" for name in ("roslib", "ros3d")]
PAGE = """<!doctype html><meta charset="utf-8"><title>rosbridge</title><link rel="icon" href="data:,">
<body style="margin:0"><div id="view"></div><script src="roslib.js"></script><script src="ros3d.js"></script>
<script>
const heard = {x: null, odom: null};
const ros = new ROSLIB.Ros({url: "ws://127.0.0.1:" + location.hash.slice(1)});
const call = (name, type, args) => new Promise((done, failed) =>
  new ROSLIB.Service({ros, name, serviceType: type}).callService(args, done, failed));
const viewer = new ROS3D.Viewer({divID: "view", width: 700, height: 520, antialias: true,
  background: "#f2f2f2", cameraPose: {x: -1.2, y: -2.2, z: 1.3}});
viewer.addObject(new ROS3D.Grid({cellSize: 0.5, num_cells: 12}));
let drawn = null;
const bodies = () => drawn.urdf ? drawn.urdf.children : [];
const begin = async () => {
  await call("/simulator/spawn", "usarmjx_msgs/Spawn", {class: "P2AT", name: "R1"});
  const tfClient = new ROSLIB.TFClient(
    {ros, fixedFrame: "map", rate: 10, angularThres: 0.01, transThres: 0.01});
  tfClient.subscribe("R1/base_link", frame => heard.x = frame.translation.x);
  drawn = new ROS3D.UrdfClient({ros, tfClient, param: "R1/robot_description", tfPrefix: "R1",
    rootObject: viewer.scene});
  new ROSLIB.Topic({ros, name: "/R1/odom", messageType: "nav_msgs/Odometry"})
    .subscribe(message => heard.odom = message.pose.pose.position.x);
};
const drive = speed => new ROSLIB.Topic({ros, name: "/R1/cmd_vel", messageType: "geometry_msgs/Twist"})
  .publish(new ROSLIB.Message({linear: {x: speed, y: 0, z: 0}, angular: {x: 0, y: 0, z: 0}}));
const asked = method => new Promise((done, failed) => ros[method](done, failed));
const about = (method, name) => new Promise((done, failed) => ros[method](name, done, failed));
const parameter = name => new Promise(done => new ROSLIB.Param({ros, name}).get(done));
</script></body>
"""


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args):
        pass


@pytest.fixture
def site(tmp_path):
    """The address of the page."""
    if missing := [file.parent.parent.name for file in SCRIPTS if not file.exists()]:
        pytest.skip(f"not installed from npm: {', '.join(missing)}")
    for script in SCRIPTS:
        shutil.copy(script, tmp_path)
    (tmp_path / "index.html").write_text(PAGE)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=tmp_path)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/index.html"
        server.shutdown()


def pixels(page, file):
    page.screenshot(file)
    return np.asarray(Image.open(io.BytesIO(file.read_bytes())).convert("RGB"), int)


@pytest.mark.alone
def test_a_page_of_roslib_asks_what_there_is_and_shows_a_robot_that_moves(browser, site, tmp_path):
    with serving_ros(DynamicWorld(FLAT), 1.0) as (port, _):
        page = browser.open(f"{site}#{port}")
        page.wait("typeof begin === 'function' && ros.isConnected")
        page.js("begin()")
        assert page.js("asked('getNodes')") == ["/usarmjx"]
        assert "/R1/odom" in page.js("asked('getTopics')")["topics"]
        assert page.js("about('getServiceType', '/simulator/spawn')") == "usarmjx_msgs/Spawn"
        assert page.js("about('getTopicType', '/R1/odom')") == "nav_msgs/msg/Odometry"
        (twist, *_) = page.js("about('getMessageDetails', 'geometry_msgs/Twist')")
        assert twist["fieldnames"] == ["linear", "angular"]
        spawn = page.js("about('getServiceRequestDetails', 'usarmjx_msgs/Spawn')")
        assert spawn["typedefs"][0]["fieldnames"] == ["class", "name", "pose", "start"]
        assert page.js("parameter('/absent')") is None
        page.wait("bodies().length >= 5 && heard.x !== null && heard.odom !== null")
        assert page.js("bodies().every(body => body.visible)"), "each link's frame came by the TF client"
        before, start = pixels(page, tmp_path / "before.png"), page.js("heard.x")
        place = "bodies().find(body => body.frameID === 'R1/base_link').position.x"
        drawn_at = page.js(place)
        page.js("drive(0.5)")
        page.wait(f"heard.x > {start} + 0.8 && {place} > {drawn_at} + 0.7")
        page.js("drive(0)")
        after = pixels(page, tmp_path / "after.png")
        page.resize(700, 520)
        assert page.js("heard.odom") > 0.5
        assert (abs(after - before).max(-1) > 60).mean() > 0.01, "the picture shows it elsewhere"
        assert page.errors == []
        page.leave()
