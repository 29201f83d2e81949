#!/bin/sh
# Fetches three.js and Spark from npm, and makes of them libraries.min.js.gz and LICENSES.txt beside this script.
# package.json names the versions. Needs npm.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here/package.json" "$here/libraries.js" "$work"
cd "$work"
npm install --silent --no-audit --no-fund
npx esbuild libraries.js --bundle --minify --format=iife --global-name=Libraries --legal-comments=eof --outfile=all.js
gzip -9nc all.js > "$here/libraries.min.js.gz"
for package in three @sparkjsdev/spark; do
  echo "libraries.min.js.gz holds parts of $package $(node -p "require('./node_modules/$package/package.json').version"):"
  echo
  cat "node_modules/$package/LICENSE"
  echo
done > "$here/LICENSES.txt"
