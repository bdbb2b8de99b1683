// SPDX-License-Identifier: Apache-2.0
// Draws the figures when they come into view, in the colours of the page's theme.
'use strict';
(() => {
  const WHOLE_ROOM_PX = 480; // where the room fits as it stands; a narrow figure cuts its sides
  const root = document.documentElement;
  const dark = matchMedia('(prefers-color-scheme: dark)');
  const figures = new Map();
  for (const script of document.querySelectorAll('script[data-figure]')) {
    figures.set(script.dataset.figure, JSON.parse(script.textContent));
  }
  const drawn = new Set();
  let chosen = null;

  const setTheme = (name) => { root.dataset.theme = name; };
  const wanted = () => chosen ?? (dark.matches ? 'dark' : 'light');
  setTheme(wanted());

  // '@name' is a colour of the page.
  // Where a colour is asked for, @name is one of the page; anywhere else it is somebody's name.
  const coloured = (value, style, key = '') => {
    if (typeof value === 'string') {
      const isNamed = key.includes('color') && value.startsWith('@');
      return isNamed ? style.getPropertyValue(`--${value.slice(1)}`).trim() : value;
    }
    if (Array.isArray(value)) {
      return typeof value[0] === 'number'
        ? value : value.map((item) => coloured(item, style, key));
    }
    if (value === null || typeof value !== 'object') return value;
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, coloured(v, style, k)]));
  };

  const laidOut = (layout, style, key) => {
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = {
      gridcolor: colour('grid'), zerolinecolor: colour('grid'), linecolor: colour('line'),
      tickcolor: colour('line'),
    };
    const own = coloured(layout, style);
    const whole = {
      autosize: true, paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
      font: { family: 'system-ui, sans-serif', size: 12, color: colour('ink') },
      hoverlabel: { bgcolor: colour('raised'), font: { color: colour('ink') } },
      margin: { l: 56, r: 12, t: 24, b: 44 }, dragmode: key === 'room-3d' ? 'turntable' : false,
      ...own,
      uirevision: key,
    };
    const { width } = document.getElementById(key).getBoundingClientRect();
    if (own.scene && width < WHOLE_ROOM_PX) {
      const { eye } = own.scene.camera;
      const farther = Math.min(WHOLE_ROOM_PX / width, 2);
      for (const side of Object.keys(eye)) eye[side] *= farther;
    }
    whole.xaxis = { ...axis, ...own.xaxis };
    whole.yaxis = { ...axis, ...own.yaxis };
    return whole;
  };

  const draw = (key) => {
    const place = document.getElementById(key);
    const figure = figures.get(key);
    const style = getComputedStyle(root);
    drawn.add(key);
    return window.Plotly.react(
      place, coloured(figure.data, style), laidOut(figure.layout, style, key),
      { responsive: true, displaylogo: false, displayModeBar: false, scrollZoom: key === 'room-3d' },
    );
  };
  const drawAgain = () => Promise.all([...drawn].map(draw));

  const unpack = async () => {
    const packed = Uint8Array.from(
      atob(document.getElementById('plotly').textContent), (c) => c.charCodeAt(0),
    );
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    const script = document.createElement('script');
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  };

  const copy = async (button) => {
    const text = button.closest('.code').querySelector('pre').textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Pages from a disk may not use the clipboard of some browsers: the older way.
      const area = document.createElement('textarea');
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand('copy');
      area.remove();
    }
    button.textContent = 'Copied';
    setTimeout(() => { button.textContent = 'Copy'; }, 1500);
  };
  for (const button of document.querySelectorAll('button.copy')) {
    button.addEventListener('click', () => copy(button));
  }

  const begin = () => {
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (entry.isIntersecting) {
          seen.unobserve(entry.target);
          draw(entry.target.id);
        }
      }
    }, { rootMargin: '600px' });
    for (const key of figures.keys()) seen.observe(document.getElementById(key));
    document.getElementById('theme').addEventListener('click', () => {
      chosen = wanted() === 'dark' ? 'light' : 'dark';
      setTheme(chosen);
      drawAgain();
    });
    dark.addEventListener('change', () => { setTheme(wanted()); drawAgain(); });
    // Paper is light, has a width of its own and holds all figures.
    addEventListener('beforeprint', () => {
      root.classList.add('paper');
      setTheme('light');
      for (const key of figures.keys()) draw(key);
    });
    addEventListener('afterprint', () => {
      root.classList.remove('paper');
      setTheme(wanted());
      drawAgain();
    });
    root.dataset.ready = 'yes';
  };
  unpack().then(begin).catch((error) => {
    root.dataset.ready = 'no';
    for (const place of document.querySelectorAll('.plot')) {
      place.textContent = `This browser cannot draw the figure: ${error.message}`;
    }
    throw error;
  });
})();
