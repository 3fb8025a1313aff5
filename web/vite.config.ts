import { defineConfig } from "vite";

// The built files go into the package, whose server sends them; its content security policy allows no inline script or style.
export default defineConfig({
  base: "/",
  build: {
    outDir: "../src/midspan/serve/page",
    emptyOutDir: true,
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    target: "es2022",
  },
});
