"use strict";
// Draws every `.rollouts` block: a bird's-eye canvas that follows the first path, heading to the right.
const PIXELS_PER_METRE = 7;

function startRollouts(block) {
  const data = JSON.parse(block.querySelector("script").textContent);
  const canvas = block.querySelector("canvas");
  const slider = block.querySelector("input");
  const button = block.querySelector("button");
  const clock = block.querySelector(".clock");
  const frames = Math.max(...data.paths.map((path) => path.poses.length));
  slider.max = frames - 1;
  block.querySelector(".legend").replaceChildren(...data.paths.concat(data.agents).filter((path) => path.label)
    .filter((path, index, all) => all.findIndex((other) => other.label === path.label) === index)
    .map(legendEntry));
  let playing = true;
  const show = () => {
    drawFrame(canvas.getContext("2d"), data, Number(slider.value));
    clock.textContent = (slider.value * data.step).toFixed(1) + " s";
  };
  button.addEventListener("click", () => {
    playing = !playing;
    button.textContent = playing ? "pause" : "play";
  });
  slider.addEventListener("input", show);
  setInterval(() => {
    if (!playing) return;
    slider.value = (Number(slider.value) + 1) % frames;
    show();
  }, data.step * 1000);
  show();
}

function legendEntry(path) {
  const entry = document.createElement("span");
  const swatch = document.createElement("i");
  swatch.style.background = path.color;
  entry.append(swatch, path.label);
  return entry;
}

function drawFrame(context, data, frame) {
  const [x, y, yaw] = poseAt(data.paths[0], frame);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, context.canvas.width, context.canvas.height);
  // World y points up, the canvas's down; the followed box stands at a third of the width, looking right.
  context.translate(context.canvas.width / 3, context.canvas.height / 2);
  context.scale(PIXELS_PER_METRE, -PIXELS_PER_METRE);
  context.rotate(-yaw);
  context.translate(-x, -y);
  data.areas.forEach((area) => fillArea(context, area, "#c9cdd3"));
  data.lines.forEach((line) => strokeLine(context, line, "#ffffff", 0.15, []));
  strokeLine(context, data.route, "#8a94a3", 0.12, [1, 1]);
  data.agents.forEach((agent) => drawBox(context, agent, agent.poses[frame]));
  data.paths.slice().reverse().forEach((path) => {
    const trail = path.poses.slice(0, frame + 1).filter((pose) => pose);
    strokeLine(context, trail, path.color, 0.25, []);
    drawBox(context, path, poseAt(path, frame));
    Object.keys(path.events).filter((event) => Number(event) <= frame)
      .forEach((event) => drawCross(context, path.poses[event], path.color));
  });
}

function poseAt(path, frame) {
  return path.poses[Math.min(frame, path.poses.length - 1)];
}

function fillArea(context, points, color) {
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.closePath();
  context.fillStyle = color;
  context.fill();
}

function strokeLine(context, points, color, width, dashes) {
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.strokeStyle = color;
  context.lineWidth = width;
  context.setLineDash(dashes);
  context.stroke();
}

function drawBox(context, path, pose) {
  if (!pose) return;
  context.save();
  context.translate(pose[0], pose[1]);
  context.rotate(pose[2]);
  context.fillStyle = path.color;
  context.fillRect(path.offset - path.length / 2, -path.width / 2, path.length, path.width);
  context.restore();
}

function drawCross(context, [x, y], color) {
  for (const slope of [1, -1]) {
    strokeLine(context, [[x - 1.5, y - 1.5 * slope], [x + 1.5, y + 1.5 * slope]], color, 0.5, []);
  }
}

document.querySelectorAll(".rollouts").forEach(startRollouts);
