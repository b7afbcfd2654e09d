"use strict";
// Two flat pictures of the same points: from the side with the ground, and by azimuth and elevation.
(() => {
  const KIND = 0, INTENSITY = 1, OBJECT = 0, PARTICLE = 1, LOST = 2, BELOW = 3;
  const MARGIN = { left: 54, right: 10, top: 10, bottom: 36 };
  const data = JSON.parse(document.getElementById("data").textContent);
  const rgb = (text) => [1, 3, 5].map((from) => parseInt(text.slice(from, from + 2), 16));
  const COLOURS = [...data.colours, data.flat.below_colour].map(rgb), RAMP = data.ramp.map(rgb);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const degrees = 180 / Math.PI;
  const { ground } = data.flat;

  const cloudOf = (entry) => {
    const position = new Int16Array(bytes(entry.position).buffer), light = new Uint16Array(bytes(entry.intensity).buffer);
    const kind = bytes(entry.kind).slice(), { count } = entry, step = data.step_m;
    const place = { x: new Float32Array(count), z: new Float32Array(count), azimuth: new Float32Array(count), elevation: new Float32Array(count), range: new Float32Array(count) };
    for (let n = 0; n < count; n += 1) {
      const [x, y, z] = [position[3 * n] * step, position[3 * n + 1] * step, position[3 * n + 2] * step], flat = Math.hypot(x, y);
      place.x[n] = x;
      // The road's cross slope is taken out, so that the ground is a line.
      place.z[n] = ground ? z - ground.slope_y * y : z;
      place.azimuth[n] = Math.atan2(y, x) * degrees;
      place.elevation[n] = Math.atan2(z, flat) * degrees;
      place.range[n] = Math.hypot(flat, z);
      const under = ground && kind[n] === PARTICLE && flat < ground.within_m && place.z[n] < ground.height_m + ground.slope_x * x - ground.under_m;
      if (under) kind[n] = BELOW;
    }
    return { ...place, light, kind, count };
  };
  const clouds = { clear: cloudOf(data.clear), weather: cloudOf(data.weather) };

  const pictures = [
    { canvas: document.getElementById("side"), across: "x", up: "z", x: data.flat.side_x_m, y: data.flat.side_z_m, xName: "x (ahead), m", yName: "height, m", steps: [10, 2], ground: true },
    { canvas: document.getElementById("angles"), across: "azimuth", up: "elevation", x: [180, -180], y: data.flat.elevation_deg, xName: "azimuth, ° (0 is ahead, 90 is left)", yName: "elevation, °", steps: [45, 5], ground: false },
  ];
  let state = { cloud: "weather", mode: KIND, shown: [true, true, true] };

  const drawn = (picture) => {
    const { canvas } = picture, ratio = Math.min(window.devicePixelRatio || 1, 2), context = canvas.getContext("2d", { willReadFrequently: true });
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const box = { left: MARGIN.left * ratio, top: MARGIN.top * ratio, right: width - MARGIN.right * ratio, bottom: height - MARGIN.bottom * ratio };
    const xOf = (value) => box.left + (value - picture.x[0]) / (picture.x[1] - picture.x[0]) * (box.right - box.left);
    const yOf = (value) => box.bottom - (value - picture.y[0]) / (picture.y[1] - picture.y[0]) * (box.bottom - box.top);
    context.fillStyle = "#0f151b";
    context.fillRect(0, 0, width, height);
    const line = picture.ground && ground ? picture.x.map((x) => yOf(ground.height_m + ground.slope_x * x)) : null;
    if (line) {
      context.fillStyle = "#2b241d";
      context.beginPath();
      context.moveTo(box.left, line[0]);
      context.lineTo(box.right, line[1]);
      context.lineTo(box.right, box.bottom);
      context.lineTo(box.left, box.bottom);
      context.fill();
    }
    points(context, picture, box, xOf, yOf, ratio);
    // What reaches beyond the axes is hidden by the margins.
    context.fillStyle = "#0f151b";
    [[0, 0, box.left, height], [0, 0, width, box.top], [box.right, 0, width, height], [0, box.bottom, width, height]].forEach(([x, y, to, down]) => context.fillRect(x, y, to - x, down - y));
    if (line) {
      context.strokeStyle = "#d9b27a";
      context.lineWidth = 1.5 * ratio;
      context.beginPath();
      context.moveTo(box.left, line[0]);
      context.lineTo(box.right, line[1]);
      context.stroke();
    }
    axes(context, picture, box, xOf, yOf, ratio);
  };

  const points = (context, picture, box, xOf, yOf, ratio) => {
    const cloud = clouds[state.cloud], across = cloud[picture.across], up = cloud[picture.up];
    const image = context.getImageData(0, 0, context.canvas.width, context.canvas.height), pixels = new Uint32Array(image.data.buffer), { width } = image;
    const shade = ([r, g, b]) => (255 << 24 | b << 16 | g << 8 | r) >>> 0;
    const plain = COLOURS.map(shade), ramp = RAMP.map(shade), top = state.mode === INTENSITY ? data.intensity_top * 65535 / data.intensity_full : data.range_top_m;
    const values = state.mode === INTENSITY ? cloud.light : cloud.range;
    [OBJECT, LOST, PARTICLE, BELOW].forEach((kind) => {
      const box_of = kind === BELOW ? PARTICLE : kind;
      if (!state.shown[box_of] || (state.mode !== KIND && kind === LOST)) return;
      const size = Math.max(1, Math.round(ratio * (kind === BELOW ? 2.4 : kind === PARTICLE ? 1.6 : 1)));
      for (let n = 0; n < cloud.count; n += 1) {
        if (cloud.kind[n] !== kind) continue;
        const x = Math.round(xOf(across[n])), y = Math.round(yOf(up[n]));
        if (x < box.left || x > box.right - size || y < box.top || y > box.bottom - size) continue;
        const colour = state.mode === KIND || kind === BELOW ? plain[kind] : ramp[Math.min(RAMP.length - 1, Math.floor(values[n] / top * RAMP.length))];
        for (let row = 0; row < size; row += 1) for (let column = 0; column < size; column += 1) pixels[(y + row) * width + x + column] = colour;
      }
    });
    context.putImageData(image, 0, 0);
  };

  const axes = (context, picture, box, xOf, yOf, ratio) => {
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.fillStyle = "#b4c2ce";
    context.strokeStyle = "#4a5a68";
    context.lineWidth = ratio;
    context.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    const ticks = ([from, to], step) => {
      const low = Math.min(from, to), high = Math.max(from, to), found = [];
      for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) found.push(value);
      return found;
    };
    const wide = (box.right - box.left) / ratio, tall = (box.bottom - box.top) / ratio;
    const spaced = (range, step, pixels, least) => { let wider = step; while (Math.abs(range[1] - range[0]) / wider > pixels / least) wider *= 2; return wider; };
    context.textAlign = "center";
    context.textBaseline = "top";
    ticks(picture.x, spaced(picture.x, picture.steps[0], wide, 44)).forEach((value) => {
      context.fillRect(xOf(value), box.bottom, ratio, 4 * ratio);
      context.fillText(String(value).replace("-", "−"), Math.min(xOf(value), box.right - 8 * ratio), box.bottom + 5 * ratio);
    });
    context.fillText(picture.xName, (box.left + box.right) / 2, box.bottom + 20 * ratio);
    context.textAlign = "right";
    context.textBaseline = "middle";
    ticks(picture.y, spaced(picture.y, picture.steps[1], tall, 22)).forEach((value) => {
      context.fillRect(box.left - 4 * ratio, yOf(value), 4 * ratio, ratio);
      context.fillText(String(value).replace("-", "−"), box.left - 7 * ratio, Math.max(yOf(value), box.top + 5 * ratio));
    });
    context.save();
    context.translate(10 * ratio, (box.top + box.bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(picture.yName, 0, 0);
    context.restore();
  };

  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; pictures.forEach(drawn); });
  };
  document.addEventListener("cloudview", (event) => { state = event.detail; redraw(); });
  pictures.forEach(({ canvas }) => new ResizeObserver(redraw).observe(canvas));
  redraw();
})();
