"use strict";
(() => {
  const KIND = 0, INTENSITY = 1, RANGE = 2, OBJECT = 0, LOST = 2, GUIDE = 3;
  const FIELD_OF_VIEW_RAD = 0.9, RING_STEPS = 96;
  const data = JSON.parse(document.getElementById("data").textContent);
  const canvas = document.getElementById("canvas"), view = document.getElementById("view"), now = document.getElementById("now");
  const gl = canvas.getContext("webgl", { antialias: true, alpha: false, preserveDrawingBuffer: true });
  if (!gl) return;

  const VERTEX = `
    attribute vec3 position; attribute float intensity, kind;
    uniform mat4 projection; uniform float step_m, size_px, mode, range_top_m, intensity_gain; uniform vec4 shown;
    uniform vec3 colours[4]; uniform vec3 ramp[24];
    varying vec3 colour;
    vec3 along(float share) {
      float at = clamp(share, 0.0, 1.0) * 23.0;
      int low = int(min(floor(at), 22.0));
      return mix(ramp[low], ramp[low + 1], at - float(low));
    }
    void main() {
      vec3 metres = position * step_m;
      gl_Position = projection * vec4(metres, 1.0);
      int which = int(kind + 0.5);
      bool guide = which == 3;
      float here = which == 0 ? shown.x : which == 1 ? shown.y : which == 2 ? shown.z : shown.w;
      colour = colours[which];
      if (!guide && mode > 0.5) {
        if (which == 2) here = 0.0;
        colour = along(mode < 1.5 ? intensity * intensity_gain : length(metres) / range_top_m);
      }
      if (here < 0.5) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
      float near = clamp(18.0 / max(gl_Position.w, 0.1), 0.75, 2.2);
      gl_PointSize = size_px * near * (which == 1 ? 1.35 : 1.0);
    }`;
  const FRAGMENT = `
    precision mediump float;
    varying vec3 colour; uniform float round_points;
    void main() {
      vec2 off = gl_PointCoord - 0.5;
      if (round_points > 0.5 && dot(off, off) > 0.25) discard;
      gl_FragColor = vec4(colour, 1.0);
    }`;

  const compiled = (type, text) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  const uniform = (name) => gl.getUniformLocation(program, name);
  const at = Object.fromEntries(["projection", "step_m", "size_px", "mode", "range_top_m", "intensity_gain", "shown", "round_points"].map((name) => [name, uniform(name)]));
  const rgb = (text) => [1, 3, 5].map((from) => parseInt(text.slice(from, from + 2), 16) / 255);
  gl.uniform3fv(uniform("colours"), [...data.colours, "#4a5a68"].flatMap(rgb));
  gl.uniform3fv(uniform("ramp"), data.ramp.flatMap(rgb));
  gl.uniform1f(at.step_m, data.step_m);
  gl.uniform1f(at.range_top_m, data.range_top_m);
  gl.uniform1f(at.intensity_gain, data.intensity_full / data.intensity_top);

  // ---- points ----------------------------------------------------------------------------------------------------
  const decoded = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const uploaded = (position, intensity, kind) => {
    const buffers = [[position, "position", 3, gl.SHORT, false], [intensity, "intensity", 1, gl.UNSIGNED_SHORT, true], [kind, "kind", 1, gl.UNSIGNED_BYTE, false]];
    const bound = buffers.map(([bytes, name, size, type, normalised]) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
      return () => {
        const place = gl.getAttribLocation(program, name);
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, size, type, normalised, 0, 0);
      };
    });
    return () => bound.forEach((bind) => bind());
  };
  const cloudOf = (entry) => {
    const kind = decoded(entry.kind), counts = [0, 0, 0];
    kind.forEach((one) => { counts[one] += 1; });
    return { bind: uploaded(decoded(entry.position), decoded(entry.intensity), kind), count: entry.count, counts };
  };
  const clouds = { clear: cloudOf(data.clear), weather: cloudOf(data.weather) };

  // ---- range rings and an arrow ahead ----------------------------------------------------------------------------
  const corners = [], loops = [];
  const line = (points) => {
    loops.push([corners.length / 3, points.length]);
    points.forEach(([x, y]) => corners.push(...[x, y, data.ground_m].map((metres) => Math.round(metres / data.step_m))));
  };
  data.rings_m.forEach((radius) => line(Array.from({ length: RING_STEPS }, (_, number) => {
    const angle = 2 * Math.PI * number / RING_STEPS;
    return [radius * Math.cos(angle), radius * Math.sin(angle)];
  })));
  line([[0, 0], [5, 0], [3.8, 0.7], [5, 0], [3.8, -0.7], [5, 0]]);
  const guide = uploaded(Int16Array.from(corners), new Uint16Array(corners.length / 3), new Uint8Array(corners.length / 3).fill(GUIDE));
  const labels = data.rings_m.map((radius) => {
    const label = document.createElement("span");
    label.className = "ring";
    label.setAttribute("aria-hidden", "true");
    label.textContent = `${radius} m`;
    view.append(label);
    return { label, radius };
  });

  // ---- camera: looks at a target from a distance -----------------------------------------------------------------
  const reach = data.range_top_m;
  const VIEWS = {
    behind: { azimuth: Math.PI, elevation: 0.5, distance: 0.62 * reach, target: [0.18 * reach, 0, 0] },
    above: { azimuth: Math.PI, elevation: Math.PI / 2 - 0.001, distance: 1.5 * reach, target: [0.1 * reach, 0, 0] },
    sensor: { azimuth: Math.PI, elevation: 0.06, distance: 1.2, target: [1, 0, 0] },
  };
  const state = { cloud: "weather", mode: KIND, shown: [true, true, true] };
  const look = {};
  const from = (name) => { Object.assign(look, VIEWS[name], { target: [...VIEWS[name].target] }); };
  from("behind");

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const axes = () => {
    const [ca, sa, ce, se] = [Math.cos(look.azimuth), Math.sin(look.azimuth), Math.cos(look.elevation), Math.sin(look.elevation)];
    return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], back: [ce * ca, ce * sa, se] };
  };
  const projection = () => {
    const { right, up, back } = axes();
    const eye = look.target.map((value, number) => value + look.distance * back[number]);
    const f = 1 / Math.tan(FIELD_OF_VIEW_RAD / 2), wide = f * canvas.height / canvas.width;
    const near = Math.max(0.05, look.distance / 200), far = look.distance + 1000;
    const a = (far + near) / (near - far), b = 2 * far * near / (near - far);
    const [tx, ty, tz] = [-dot(right, eye), -dot(up, eye), -dot(back, eye)];
    const rows = [[wide * right[0], wide * right[1], wide * right[2], wide * tx], [f * up[0], f * up[1], f * up[2], f * ty],
      [a * back[0], a * back[1], a * back[2], a * tz + b], [-back[0], -back[1], -back[2], -tz]];
    return [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
  };

  const draw = () => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const matrix = projection(), cloud = clouds[state.cloud];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0x0f / 255, 0x15 / 255, 0x1b / 255, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(at.projection, false, matrix);
    gl.uniform1f(at.mode, state.mode);
    gl.uniform1f(at.size_px, 1.9 * ratio);
    gl.uniform4f(at.shown, ...state.shown.map(Number), 1);
    gl.uniform1f(at.round_points, 0);
    guide();
    loops.forEach(([start, count], number) => gl.drawArrays(number < labels.length ? gl.LINE_LOOP : gl.LINE_STRIP, start, count));
    gl.uniform1f(at.round_points, 1);
    cloud.bind();
    gl.drawArrays(gl.POINTS, 0, cloud.count);
    labels.forEach(({ label, radius }) => {
      const point = [radius, 0, data.ground_m, 1];
      const [x, y, , w] = [0, 1, 2, 3].map((row) => point.reduce((sum, value, column) => sum + matrix[4 * column + row] * value, 0));
      const inside = w > 0.1 && Math.abs(x / w) < 0.96 && y / w > -0.96 && y / w < 0.96;
      label.hidden = !inside;
      if (inside) label.style.transform = `translate(${(0.5 + x / w / 2) * canvas.clientWidth + 4}px, ${(0.5 - y / w / 2) * canvas.clientHeight - 18}px)`;
    });
  };
  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };

  // ---- buttons and words -----------------------------------------------------------------------------------------
  const grouped = (number) => String(number).replace(/\B(?=(\d{3})+$)/g, "\u202f");
  const words = () => {
    const { counts } = clouds[state.cloud];
    document.querySelectorAll("[data-cloud]").forEach((button) => button.setAttribute("aria-pressed", button.dataset.cloud === state.cloud));
    document.querySelectorAll("[data-colour]").forEach((button) => button.setAttribute("aria-pressed", Number(button.dataset.colour) === state.mode));
    [INTENSITY, RANGE].forEach((mode) => { const scale = document.getElementById(`scale${mode}`); if (scale) scale.hidden = state.mode !== mode; });
    counts.forEach((count, kind) => { document.getElementById(`n${kind}`).textContent = grouped(count); });
    now.replaceChildren(document.createElement("strong"), document.createElement("br"), document.createElement("span"));
    now.firstChild.textContent = state.cloud === "clear" ? "Clear air" : "Weather";
    now.lastChild.textContent = `${grouped(clouds[state.cloud].count - counts[LOST])} points shown`;
    now.hidden = false;
    tell();
    redraw();
  };
  // The flat pictures follow.
  const tell = () => document.dispatchEvent(new CustomEvent("cloudview", { detail: { ...state, shown: [...state.shown] } }));
  document.querySelectorAll("[data-cloud]").forEach((button) => button.addEventListener("click", () => { state.cloud = button.dataset.cloud; words(); }));
  document.querySelectorAll("[data-colour]").forEach((button) => button.addEventListener("click", () => { state.mode = Number(button.dataset.colour); words(); }));
  document.querySelectorAll("[data-kind]").forEach((box) => box.addEventListener("change", () => { state.shown[Number(box.dataset.kind)] = box.checked; tell(); redraw(); }));
  document.querySelectorAll("[data-from]").forEach((button) => button.addEventListener("click", () => { from(button.dataset.from); redraw(); }));
  document.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "w" || event.ctrlKey || event.metaKey || event.altKey) return;
    state.cloud = state.cloud === "clear" ? "weather" : "clear";
    words();
  });

  // ---- mouse, touch, keys ----------------------------------------------------------------------------------------
  const turn = (dx, dy) => {
    look.azimuth -= dx;
    look.elevation = Math.min(Math.PI / 2 - 0.001, Math.max(-Math.PI / 2 + 0.001, look.elevation + dy));
  };
  const move = (dx, dy) => {
    const { right, up } = axes(), metres = 2 * look.distance * Math.tan(FIELD_OF_VIEW_RAD / 2) / canvas.clientHeight;
    look.target = look.target.map((value, number) => value - metres * (dx * right[number] - dy * up[number]));
  };
  const zoom = (factor) => { look.distance = Math.min(600, Math.max(0.5, look.distance * factor)); };
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const after = [event.clientX, event.clientY], dx = after[0] - before[0], dy = after[1] - before[1];
    if (pointers.size === 1) {
      if (event.shiftKey || event.buttons & 6) move(dx, dy); else turn(dx * 0.006, dy * 0.006);
    } else if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      zoom(Math.max(1, apart(before)) / Math.max(1, apart(after)));
      move(dx / 2, dy / 2);
    }
    pointers.set(event.pointerId, after);
    redraw();
  });
  ["pointerup", "pointercancel"].forEach((name) => canvas.addEventListener(name, (event) => pointers.delete(event.pointerId)));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.max(-0.4, Math.min(0.4, event.deltaY * 0.0015))));
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (step) { if (event.shiftKey) move(-30 * step[0], -30 * step[1]); else turn(0.09 * step[0], -0.09 * step[1]); }
    else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1 / 0.85);
    else return;
    event.preventDefault();
    redraw();
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => location.reload());
  new ResizeObserver(redraw).observe(canvas);
  window.addEventListener("beforeprint", draw);

  document.getElementById("failed").hidden = true;
  words();
})();
