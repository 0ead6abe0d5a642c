// Plays the drives of a page: what each figure holds as numbers (see player.py), drawn from above.
"use strict";

const MARGIN = 2; // around the arena [m]
const CLOSE = 13; // half side of what is drawn around the vehicle [m]
const SMALL = 4; // half a vehicle that is too small to see is drawn as large as this [CSS pixels]
const LONGEST = 20; // time that it takes at most to play a drive [s]

const sums = (differences) => {
  let sum = 0;
  return differences.map((difference) => (sum += difference) / 100);
};

const decoded = (text) => {
  const drive = JSON.parse(text);
  for (const name of ["x", "y", "yaw", "times"]) drive[name] = sums(drive[name]);
  let state = 0; // the decision that each pose comes after
  drive.state = drive.x.map((_, i) => {
    while (state + 1 < drive.times.length && drive.times[state + 1] <= timeOf(drive, i) + 1e-6) state += 1;
    return state;
  });
  return drive;
};

const timeOf = (drive, i) => (i === drive.x.length - 1 ? drive.end : i / drive.rate);

// The box of a patrol at a time [s]: it moves evenly from one of its places to the next.
const patrolAt = ({ box: [, , ...rest], places }, time) => {
  const after = Math.max(places.findIndex(([then]) => then >= time - 1e-6), 1);
  const [[begin, x, y], [end, nextX, nextY]] = [places[after - 1], places[after]];
  const share = (time - begin) / (end - begin);
  return [x + share * (nextX - x), y + share * (nextY - y), ...rest];
};

// Draws the moment of pose i on a canvas, around a point and so far to all sides [m].
const draw = (canvas, drive, i, x, y, half) => {
  const context = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  const colour = (name) => style.getPropertyValue(`--${name}`);
  const size = Math.max(Math.round(canvas.clientWidth * devicePixelRatio), 1);
  canvas.width = canvas.height = size; // which clears it
  const scale = size / (2 * half);
  const pixel = devicePixelRatio / scale;
  context.setTransform(scale, 0, 0, -scale, size / 2 - scale * x, size / 2 + scale * y);
  context.lineJoin = context.lineCap = "round";

  const shape = (trace, fill, stroke, width = 1) => {
    context.beginPath();
    trace();
    context.lineWidth = width * pixel;
    if (fill) {
      context.fillStyle = fill;
      context.fill();
    }
    if (stroke) {
      context.strokeStyle = stroke;
      context.stroke();
    }
  };
  // What is traced is given in the frame of a pose.
  const within = (px, py, yaw, trace) => () => {
    context.save();
    context.translate(px, py);
    context.rotate(yaw);
    trace();
    context.restore();
  };
  const box = ([px, py, length, width, yaw]) =>
    within(px, py, yaw, () => context.rect(-length, -width, 2 * length, 2 * width));

  shape(() => context.rect(0, 0, ...drive.arena), colour("shade"), colour("soft"), 2);
  for (const one of drive.boxes) shape(box(one), colour("box"), colour("soft"));
  for (const one of drive.circles) shape(() => context.arc(...one, 0, 2 * Math.PI), colour("box"), colour("soft"));
  for (const patrol of drive.patrols) {
    shape(() => (context.moveTo(patrol.box[0], patrol.box[1]), context.lineTo(...patrol.end)), null, colour("moving"));
    shape(box(patrolAt(patrol, timeOf(drive, i))), colour("moving"), colour("soft"));
  }
  const [targetX, targetY, radius] = drive.target;
  shape(() => context.arc(targetX, targetY, radius, 0, 2 * Math.PI), null, colour("target"), 2);

  // Each sensor as it was read at the last decision, where it was read.
  const state = drive.state[i];
  const read = drive.state.indexOf(state);
  const angle = (2 * Math.PI) / drive.sectors;
  for (let sector = 0; sector < drive.sectors; sector += 1) {
    const reading = drive.readings[drive.sectors * state + sector] / 10;
    const wedge = () => {
      context.moveTo(...drive.sensor);
      context.arc(...drive.sensor, reading, (sector - 0.5) * angle, (sector + 0.5) * angle);
    };
    const fill = `hsl(${(210 * reading) / drive.range} 85% 50% / 0.3)`;
    shape(within(drive.x[read], drive.y[read], drive.yaw[read], wedge), fill);
  }

  const path = (safe) => () => {
    for (let j = 0; j < i; j += 1) {
      if ((drive.states[drive.state[j]] !== "N") !== safe) continue;
      context.moveTo(drive.x[j], drive.y[j]);
      context.lineTo(drive.x[j + 1], drive.y[j + 1]);
    }
  };
  shape(path(true), null, colour("safe"), 2);
  shape(path(false), null, colour("non-safe"), 2);
  const [ahead, aside, length] = drive.footprint;
  const dot = () => context.arc(ahead, aside, SMALL * pixel, 0, 2 * Math.PI);
  const vehicle = length < SMALL * pixel ? dot : box(drive.footprint);
  shape(within(drive.x[i], drive.y[i], drive.yaw[i], vehicle), colour("vehicle"), colour("ink"));
};

const element = (name, attributes = {}) => {
  const made = document.createElement(name);
  for (const [attribute, value] of Object.entries(attributes)) made.setAttribute(attribute, value);
  return made;
};

const play = (figure) => {
  const drive = decoded(figure.querySelector("script").textContent);
  const last = drive.x.length - 1;
  const canvas = (what) => element("canvas", { role: "img", "aria-label": `${drive.title}: ${what}` });
  const [whole, close] = [canvas("the whole arena"), canvas("around the vehicle")];
  const button = element("button", { type: "button" });
  const scrubber = element("input", { type: "range", min: 0, max: last, "aria-label": `Time in ${drive.title}` });
  const clock = element("output");
  scrubber.value = last; // shown, and printed, as it ended

  const [width, depth] = drive.arena;
  const show = () => {
    const i = Number(scrubber.value);
    const state = drive.states[drive.state[i]] === "N" ? "non-safe" : "safe";
    clock.textContent = `${timeOf(drive, i).toFixed(1)} s, ${i === last ? drive.ending : state}`;
    scrubber.setAttribute("aria-valuetext", clock.textContent);
    draw(whole, drive, i, width / 2, depth / 2, Math.max(width, depth) / 2 + MARGIN);
    draw(close, drive, i, drive.x[i], drive.y[i], CLOSE);
  };

  let frame = 0; // of the animation, while it plays
  const stop = () => {
    cancelAnimationFrame(frame);
    frame = 0;
    button.textContent = "Play";
  };
  const start = () => {
    const first = Number(scrubber.value) === last ? 0 : Number(scrubber.value);
    const rate = drive.rate * Math.max(drive.end / LONGEST, 1);
    let begin;
    const next = (now) => {
      begin ??= now;
      scrubber.value = first + Math.floor(((now - begin) / 1000) * rate);
      show();
      if (Number(scrubber.value) < last) frame = requestAnimationFrame(next);
      else stop();
    };
    frame = requestAnimationFrame(next);
    button.textContent = "Pause";
  };
  button.addEventListener("click", () => (frame ? stop() : start()));
  scrubber.addEventListener("input", () => (stop(), show()));

  const views = element("div", { class: "views" });
  const controls = element("div", { class: "controls" });
  views.append(whole, close);
  controls.append(button, scrubber, clock);
  figure.prepend(views, controls);
  stop();
  show();
  new ResizeObserver(show).observe(views);
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", show);
};

document.querySelectorAll("figure.player").forEach(play);
