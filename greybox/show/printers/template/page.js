"use strict";
(async () => {
  // Plotly travels packed: unpack it and run it as a script of this page.
  const packed = document.getElementById("plotly");
  if (packed) {
    const bytes = Uint8Array.from(atob(packed.textContent), (c) => c.charCodeAt(0));
    const script = document.createElement("script");
    script.textContent = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
    document.head.append(script);
    packed.remove();
  }

  const root = document.documentElement;
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const figures = [...document.querySelectorAll("figure.drawn")].map((element) => ({
    element,
    plot: element.querySelector(".plot"),
    shown: 0,
    ...JSON.parse(element.querySelector('script[type="application/json"]').textContent),
  }));

  // A colour in a figure is the name of a variable of the page's style, so that it follows light and dark.
  const painted = (value) => {
    if (typeof value === "string") return value.startsWith("--") ? colour(value) : value;
    if (Array.isArray(value)) return value.some((v) => typeof v === "string" || (v && typeof v === "object")) ? value.map(painted) : value;
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, painted(inner)]));
    return value;
  };

  const narrow = () => window.innerWidth < 640;
  // So few numbers along a logarithmic axis that 8, 9 and 10 do not stand on one another.
  const logarithmic = (figure, letter) =>
    letter === "x"
      ? { exponentformat: "none", nticks: narrow() ? 3 : 6 }
      : { exponentformat: "power", nticks: Math.max(2, Math.floor((parseFloat(figure.plot.style.height) - 100) / 45)) };
  // A title along an axis is broken at the blank nearest to its middle where it is longer than the axis.
  const broken = (text, room) => {
    if (!text || 7.5 * text.length <= room) return text;
    const blanks = [...text.matchAll(/ /g)].map((found) => found.index);
    if (!blanks.length) return text;
    const middle = blanks.reduce((best, k) => (Math.abs(k - text.length / 2) < Math.abs(best - text.length / 2) ? k : best));
    return `${text.slice(0, middle)}<br>${text.slice(middle + 1)}`;
  };
  // A legend has at most half of a figure's height, and hides the names beyond: a figure with many or long names is as high as they need.
  const roomFor = (figure, height, width) => {
    const names = new Set(figure.data.filter((trace) => trace.showlegend && trace.name).map((trace) => trace.name));
    const columns = Math.max(1, Math.floor(width / (50 + 7 * Math.max(0, ...[...names].map((name) => name.length)))));
    return `${Math.max(height, 2 * (20 * Math.ceil(names.size / columns) + 12))}px`;
  };
  const styled = (figure, chosen = figure.shown) => {
    const axis = { gridcolor: colour("--line"), zerolinecolor: colour("--line"), linecolor: colour("--line"), automargin: true };
    const own = painted(figure.views[chosen].layout);
    const axes = Object.fromEntries(
      Object.keys({ xaxis: 0, yaxis: 0, ...own }).filter((key) => /^[xy]axis/.test(key)).map((key) => {
        const title = { standoff: 12, ...own[key]?.title };
        if (key[0] === "y") title.text = broken(title.text, parseFloat(figure.plot.style.height) - 60);
        // On paper, beside names as long as these.
        else if (paper) title.text = broken(title.text, HALF - 40 - 7.5 * Math.max(0, ...(own.yaxis?.ticktext ?? []).map((name) => name.length)));
        return [key, { ...axis, ...(own[key]?.type === "log" ? logarithmic(figure, key[0]) : {}), ...own[key], title, uirevision: key[0] === "x" && figure.group ? "kept" : String(chosen) }];
      }));
    return {
      // Values beside bars need room.
      margin: { l: narrow() ? 44 : 60, r: figure.data.some((trace) => trace.text) ? (narrow() ? 54 : 30) : 16, t: 16, b: 44 }, hovermode: "x unified", showlegend: true, uirevision: "kept",
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      ...own, ...axes,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("--ink"), family: getComputedStyle(document.body).fontFamily, size: narrow() ? 11 : 13 },
      hoverlabel: { bgcolor: colour("--panel"), bordercolor: colour("--line"), font: { color: colour("--ink") } },
      ...(paper ? { width: figure.element.parentElement.id === "content" && figure.views.length === 1 ? PAPER : HALF, height: figure.plot.clientHeight } : {}),
    };
  };

  // Pixels that a sheet of paper is wide while printing, and those of a figure that shares it with another one; its height over that on a screen.
  const PAPER = 1070, HALF = 520, PAPER_HEIGHT = 0.6;
  const caption = (element) => element?.querySelector("figcaption").textContent;
  let paper = false;
  const curves = (figure, chosen = figure.shown) => {
    const shown = new Set(figure.views[chosen].traces);
    return figure.data.map((trace, k) => ({ ...painted(trace), visible: shown.has(k) }));
  };
  const draw = (figure) => {
    return Plotly.react(figure.plot, curves(figure), styled(figure), { responsive: !paper, displaylogo: false, displayModeBar: false });
  };

  // Amplitude density of a stretch: Hann window, gaps as the mean and not as rows, as the page's own spectra.
  const spectrum = (values, step) => {
    const rows = values.length, known = values.filter((v) => v !== null);
    if (rows < 16 || !known.length) return null;
    const mean = known.reduce((a, b) => a + b, 0) / known.length;
    let n = 1;
    while (n < rows) n *= 2;
    const re = new Float64Array(n), im = new Float64Array(n);
    let power = 0;
    for (let k = 0; k < rows; k++) {
      const w = 0.5 - 0.5 * Math.cos((2 * Math.PI * k) / rows);
      if (values[k] !== null) power += w * w;
      re[k] = w * ((values[k] ?? mean) - mean);
    }
    transform(re, im);
    const f = [], a = [];
    for (let k = Math.max(1, Math.round(n / rows)); k <= n / 2; k++) {
      f.push(k / (n * step));
      a.push(Math.sqrt((2 * step * (re[k] * re[k] + im[k] * im[k])) / power));
    }
    return { f, a };
  };

  // Fast Fourier transform in place, length a power of two.
  const transform = (re, im) => {
    const n = re.length;
    for (let i = 1, j = 0; i < n; i++) {
      let bit = n >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) {
        [re[i], re[j]] = [re[j], re[i]];
        [im[i], im[j]] = [im[j], im[i]];
      }
    }
    for (let length = 2; length <= n; length *= 2) {
      for (let i = 0; i < n; i += length)
        for (let k = 0; k < length / 2; k++) {
          const angle = (-2 * Math.PI * k) / length, c = Math.cos(angle), s = Math.sin(angle);
          const p = i + k, q = p + length / 2;
          const x = re[q] * c - im[q] * s, y = re[q] * s + im[q] * c;
          [re[q], im[q], re[p], im[p]] = [re[p] - x, im[p] - y, re[p] + x, im[p] + y];
        }
    }
  };

  // What is zoomed along the horizontal axis in one figure of a group is zoomed in all of them.
  const zoomed = (figure, change) => {
    if (!figure.group) return;
    const low = change["xaxis.range[0]"] ?? change["xaxis.range"]?.[0], high = change["xaxis.range[1]"] ?? change["xaxis.range"]?.[1];
    const whole = change["xaxis.autorange"] === true;
    if (low === undefined && !whole) return;
    const range = whole ? null : [Number(low), Number(high)];
    if (String(range) === String(figure.range ?? null)) return; // an echo of a zoom that is known
    const together = figures.filter((other) => other.group === figure.group);
    for (const other of together) other.range = range;
    for (const other of together) {
      if (other !== figure) Plotly.relayout(other.plot, whole ? { "xaxis.autorange": true } : { "xaxis.range": [...range] });
      respectrum(other);
    }
  };

  // The spectra that are shown of the stretch that is looked at.
  const respectrum = (figure) => {
    for (const target of figures) {
      const shown = new Set(target.views[target.shown].traces);
      const followed = target.signals.filter((signal) => signal.figure === figure.element.id && shown.has(signal.trace));
      for (const signal of followed) retake(figure, target, signal);
      if (followed.length) draw(target);
    }
  };

  const retake = (figure, target, { start, step, values, trace }) => {
    target.whole ??= {};
    target.whole[trace] ??= { x: target.data[trace].x, y: target.data[trace].y };
    let shown = target.whole[trace];
    if (figure.range) {
      const [first, last] = figure.range.map((t) => Math.min(Math.max(Math.round((t - start) / step), 0), values.length - 1));
      const found = spectrum(values.slice(first, last + 1), step);
      if (found) shown = { x: found.f, y: found.a };
    }
    target.data[trace] = { ...target.data[trace], ...shown };
  };

  const choose = (figure, name) => {
    const together = figures.filter((other) => other === figure || (figure.switch && other.switch === figure.switch));
    for (const one of together) {
      const k = one.views.findIndex((view) => view.name === name);
      if (k < 0) continue;
      one.shown = k;
      for (const button of one.element.querySelectorAll(".choices button")) button.setAttribute("aria-pressed", String(button.textContent === name));
      draw(one);
    }
    together.forEach(respectrum);
  };

  const dress = (dark) => {
    root.dataset.theme = dark ? "dark" : "light";
    const button = document.getElementById("theme");
    button.setAttribute("aria-pressed", String(dark));
    figures.forEach(draw);
  };

  if (narrow()) figures.forEach((figure) => (figure.plot.style.height = roomFor(figure, parseFloat(figure.plot.style.height), window.innerWidth - 80)));
  const preferred = window.matchMedia("(prefers-color-scheme: dark)");
  dress(preferred.matches);
  preferred.addEventListener("change", (event) => dress(event.matches));
  document.getElementById("theme").addEventListener("click", () => dress(root.dataset.theme !== "dark"));

  for (const figure of figures) {
    const choices = figure.element.querySelector(".choices");
    if (figure.views.length > 1)
      for (const [k, { name }] of figure.views.entries()) {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = name;
        button.setAttribute("aria-pressed", String(k === figure.shown));
        button.addEventListener("click", () => choose(figure, name));
        choices.append(button);
      }
    figure.plot.on("plotly_relayout", (change) => zoomed(figure, change));
  }

  // A figure inside a fold has no size until it is opened.
  for (const fold of document.querySelectorAll("details"))
    fold.addEventListener("toggle", () => {
      if (fold.open) figures.filter((f) => fold.contains(f.element)).forEach((f) => Plotly.Plots.resize(f.plot));
    });

  // Paper has no buttons: what they choose between stands below one another, each with its name.
  const spread = (figure) => {
    if (figure.views.length < 2) return;
    for (const [k, { name }] of figure.views.entries()) {
      const title = document.createElement("p");
      title.className = "name printed";
      title.textContent = name;
      if (k === figure.shown) {
        figure.plot.before(title);
        continue;
      }
      const view = document.createElement("div"), plot = document.createElement("div");
      view.className = "view printed";
      plot.className = "plot";
      plot.style.height = figure.plot.style.height;
      view.append(title, plot);
      figure.element.querySelector("figcaption").before(view);
      Plotly.newPlot(plot, curves(figure, k), { ...styled(figure, k), height: parseFloat(plot.style.height) }, { staticPlot: true });
    }
  };

  // On paper everything is light; folds are open but for those that hold figures, which are printed where the reader has opened them.
  let before = [];
  window.addEventListener("beforeprint", () => {
    before = [root.dataset.theme === "dark", [...document.querySelectorAll("details:not([open]):not(.words):not(:has(figure, > .code))")], new Map()];
    before[1].forEach((d) => (d.open = true));
    paper = true;
    for (const figure of figures) {
      // What the page shows at its head is not printed again, and two figures beside one another are less high.
      figure.element.classList.toggle("again", figure.element.id !== "evidence" && caption(figure.element) === caption(document.getElementById("evidence")));
      before[2].set(figure, figure.plot.style.height);
      if (figure.element.id !== "evidence") figure.plot.style.height = roomFor(figure, PAPER_HEIGHT * parseFloat(figure.plot.style.height), HALF - 80);
    }
    dress(false);
    figures.forEach(spread);
  });
  window.addEventListener("afterprint", () => {
    document.querySelectorAll(".printed").forEach((extra) => extra.remove());
    before[1].forEach((d) => (d.open = false));
    before[2].forEach((height, figure) => (figure.plot.style.height = height));
    paper = false;
    dress(before[0]);
  });
  window.greyboxReady = true;
})();
