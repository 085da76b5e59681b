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
    ...JSON.parse(element.querySelector('script[type="application/json"]').textContent),
  }));

  // A colour in a figure is the name of a variable of the page's style, so that it follows light and dark.
  const painted = (value) => {
    if (typeof value === "string") return value.startsWith("--") ? colour(value) : value;
    if (Array.isArray(value)) return value.length && typeof value[0] === "number" ? value : value.map(painted);
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, painted(inner)]));
    return value;
  };

  const styled = (layout) => {
    const axis = { gridcolor: colour("--line"), zerolinecolor: colour("--line"), linecolor: colour("--line"), automargin: true };
    const own = painted(layout);
    const axes = Object.fromEntries(
      Object.keys({ xaxis: 0, yaxis: 0, ...own }).filter((key) => /^[xy]axis/.test(key)).map((key) => [key, { ...axis, ...own[key] }]));
    return {
      margin: { l: 60, r: 16, t: 16, b: 44 }, hovermode: "x unified", showlegend: true,
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      ...own, ...axes,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("--ink"), family: getComputedStyle(document.body).fontFamily, size: 13 },
      hoverlabel: { bgcolor: colour("--panel"), bordercolor: colour("--line"), font: { color: colour("--ink") } },
    };
  };

  const draw = (figure) => {
    const shown = figure.shown && new Set(figure.choices[figure.shown]);
    const data = figure.data.map((trace, k) => ({ ...painted(trace), ...(shown && { visible: shown.has(k) }) }));
    return Plotly.react(figure.plot, data, styled(figure.layout), { responsive: true, displaylogo: false });
  };

  // Amplitude density of a stretch: Hann window, as the page's own spectra.
  const spectrum = (time, values) => {
    let n = 1;
    while (2 * n <= Math.min(values.length, 8192)) n *= 2;
    if (n < 16) return null;
    const mean = values.slice(0, n).reduce((a, b) => a + (b ?? 0), 0) / n;
    const re = new Float64Array(n), im = new Float64Array(n);
    let power = 0;
    for (let k = 0; k < n; k++) {
      const w = 0.5 - 0.5 * Math.cos((2 * Math.PI * k) / n);
      power += w * w;
      re[k] = w * ((values[k] ?? mean) - mean);
    }
    transform(re, im);
    const step = (time[n - 1] - time[0]) / (n - 1), f = [], a = [];
    for (let k = 1; k < n / 2; k++) {
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

  // Plotly tells of a zoom after the call that made it has returned: a figure that already shows the stretch is left
  // alone, or two linked figures would send it back and forth for ever.
  const shows = (plot, range) => {
    const axis = plot.layout.xaxis;
    return range ? !axis.autorange && axis.range[0] === range[0] && axis.range[1] === range[1] : axis.autorange === true;
  };

  const zoomed = (figure, change) => {
    const low = change["xaxis.range[0]"] ?? change["xaxis.range"]?.[0], high = change["xaxis.range[1]"] ?? change["xaxis.range"]?.[1];
    const whole = change["xaxis.autorange"] === true;
    if (low === undefined && !whole) return;
    const range = whole ? null : [low, high];
    for (const one of figures) {
      if (one !== figure && !(figure.group && one.group === figure.group)) continue;
      if (!shows(one.plot, range)) Plotly.relayout(one.plot, range ? { "xaxis.range": range } : { "xaxis.autorange": true });
      respectrum(one, range && range.map(Number));
    }
  };

  const respectrum = (figure, range) => {
    const signal = figure.signal;
    const target = signal.figure && figures.find((f) => f.element.id === signal.figure);
    if (!target) return;
    const rows = signal.time.map((t, k) => k).filter((k) => !range || (signal.time[k] >= range[0] && signal.time[k] <= range[1]));
    const found = spectrum(rows.map((k) => signal.time[k]), rows.map((k) => signal.values[k]));
    if (found) Plotly.restyle(target.plot, { x: [found.f], y: [found.a] }, [signal.trace ?? 0]);
  };

  const choose = (figure, name) => {
    figure.shown = name;
    draw(figure);
    for (const button of figure.element.querySelectorAll(".choices button")) button.setAttribute("aria-pressed", String(button.textContent === name));
  };

  const dress = (dark) => {
    root.dataset.theme = dark ? "dark" : "light";
    const button = document.getElementById("theme");
    button.setAttribute("aria-pressed", String(dark));
    figures.forEach(draw);
  };

  const preferred = window.matchMedia("(prefers-color-scheme: dark)");
  dress(preferred.matches);
  preferred.addEventListener("change", (event) => dress(event.matches));
  document.getElementById("theme").addEventListener("click", () => dress(root.dataset.theme !== "dark"));

  for (const figure of figures) {
    const names = Object.keys(figure.choices);
    for (const name of names) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.addEventListener("click", () => choose(figure, name));
      figure.element.querySelector(".choices").append(button);
    }
    if (names.length) choose(figure, names[0]);
    figure.plot.on("plotly_relayout", (change) => zoomed(figure, change));
  }

  // On paper everything is light, open and as wide as the page.
  let before = [];
  window.addEventListener("beforeprint", () => {
    before = [root.dataset.theme === "dark", [...document.querySelectorAll("details:not([open]):not(.words)")]];
    before[1].forEach((d) => (d.open = true));
    dress(false);
  });
  window.addEventListener("afterprint", () => {
    before[1].forEach((d) => (d.open = false));
    dress(before[0]);
  });
  window.greyboxReady = true;
})();
